//! The pose workbook: rows found by the names of their columns.
//!
//! A workbook is a ZIP archive of XML. Its cells are read one by one, never as the table spanned by the farthest
//! cell, and the archive is unpacked once on trial, because a few kilobytes can unpack to gigabytes.

use crate::malformed::Malformed;
use crate::natural;
use calamine::{Data, DataRef, Reader as _, Xlsx};
use endoscape_core::{Pose, se3};
use std::collections::BTreeMap;
use std::io::{Cursor, Read as _};

/// Most bytes a workbook may unpack to.
const LARGEST_UNPACKED: u64 = 256 << 20;
/// Columns looked at; the data set's workbooks have nine.
const MOST_COLUMNS: u32 = 64;
/// Names of the columns, in the order of [`pose`], with the spelling the data set would have meant.
const COLUMNS: [[&str; 2]; 8] = [
    ["imageframe", "image_frame"],
    ["trans_x", "tx"],
    ["trans_y", "ty"],
    ["trans_z", "tz"],
    ["quot_x", "quat_x"],
    ["quot_y", "quat_y"],
    ["quot_z", "quat_z"],
    ["quot_w", "quat_w"],
];

/// A pose and the frame it belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseRow {
    /// The number in the frame's file name.
    pub frame: usize,
    /// Its pose in metres.
    pub world_from_camera: Pose,
}

/// Cells of one row by column.
type Row = BTreeMap<u32, Data>;

/// Reads the first sheet of a workbook.
///
/// # Errors
/// [`Malformed`] if the bytes are no workbook, a column is missing, or with the row of the first bad cell.
pub fn parse_workbook(bytes: &[u8]) -> Result<Vec<PoseRow>, Malformed> {
    check_unpacked_size(bytes)?;
    let unreadable = |error: calamine::XlsxError| Malformed::whole(format!("is no readable XLSX workbook ({error})"));
    let mut workbook: Xlsx<_> = Xlsx::new(Cursor::new(bytes)).map_err(unreadable)?;
    let sheet =
        workbook.sheet_names().first().cloned().ok_or_else(|| Malformed::whole("is a workbook without sheets"))?;
    let mut cells = workbook.worksheet_cells_reader(&sheet).map_err(unreadable)?;
    let mut table = Table::default();
    while let Some(cell) = cells.next_cell().map_err(unreadable)? {
        let (row, column) = cell.get_position();
        if column < MOST_COLUMNS {
            table.take(row, column, cell.get_value())?;
        }
    }
    table.finish()
}

/// Refuses an archive that unpacks to absurd sizes, whatever its headers claim.
fn check_unpacked_size(bytes: &[u8]) -> Result<(), Malformed> {
    let unreadable =
        |error: &dyn std::fmt::Display| Malformed::whole(format!("is no readable XLSX workbook ({error})"));
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(|error| unreadable(&error))?;
    let mut left = LARGEST_UNPACKED;
    for index in 0..archive.len() {
        let entry = archive.by_index(index).map_err(|error| unreadable(&error))?;
        let unpacked =
            std::io::copy(&mut entry.take(left), &mut std::io::sink()).map_err(|error| unreadable(&error))?;
        left -= unpacked;
        if left == 0 {
            let reason = format!("unpacks to more than {} MiB, which no pose workbook does", LARGEST_UNPACKED >> 20);
            return Err(Malformed::whole(reason));
        }
    }
    Ok(())
}

/// The table as its cells come in, row by row.
#[derive(Default)]
struct Table {
    columns: Option<[u32; 8]>,
    current: (u32, Row),
    poses: Vec<PoseRow>,
}

impl Table {
    fn take(&mut self, row: u32, column: u32, value: &DataRef<'_>) -> Result<(), Malformed> {
        if row != self.current.0 {
            self.close_row()?;
            self.current.0 = row;
        }
        self.current.1.insert(column, value.clone().into());
        Ok(())
    }

    fn close_row(&mut self) -> Result<(), Malformed> {
        let (index, row) = (self.current.0, std::mem::take(&mut self.current.1));
        if row.values().all(|cell| *cell == Data::Empty) {
            return Ok(());
        }
        let line = index as usize + 1;
        match &self.columns {
            None => self.columns = Some(header(&row).map_err(|reason| Malformed::line(line, reason))?),
            Some(columns) => self.poses.push(pose(&row, columns).map_err(|reason| Malformed::line(line, reason))?),
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Vec<PoseRow>, Malformed> {
        self.close_row()?;
        match self.columns {
            None => Err(Malformed::whole("is a workbook whose first sheet is empty")),
            Some(_) => Ok(self.poses),
        }
    }
}

/// Where each of [`COLUMNS`] stands.
fn header(row: &Row) -> Result<[u32; 8], String> {
    let mut columns = [0; 8];
    for (column, names) in columns.iter_mut().zip(COLUMNS) {
        let is_named =
            |cell: &Data| matches!(cell, Data::String(text) if names.contains(&text.trim().to_lowercase().as_str()));
        *column = row.iter().find(|(_, cell)| is_named(cell)).map(|(column, _)| *column).ok_or_else(|| {
            format!("has no column {} (expected ImageFrame, trans_x to trans_z, quot_x to quot_w)", names[0])
        })?;
    }
    Ok(columns)
}

fn pose(row: &Row, columns: &[u32; 8]) -> Result<PoseRow, String> {
    let cell = |index: usize| row.get(&columns[index]).unwrap_or(&Data::Empty);
    let mut n = [0.0; 8];
    for (index, number) in n.iter_mut().enumerate().skip(1) {
        *number = finite(cell(index), COLUMNS[index][0])?;
    }
    let world_from_camera = se3::from_quaternion([n[1], n[2], n[3]], [n[4], n[5], n[6], n[7]]);
    Ok(PoseRow { frame: frame(cell(0))?, world_from_camera: world_from_camera.map_err(|error| error.to_string())? })
}

/// A frame number, also one that stands in a file name.
fn frame(cell: &Data) -> Result<usize, String> {
    let number = match cell {
        Data::Int(number) => usize::try_from(*number).ok(),
        Data::Float(number) if number.fract() == 0.0 && (0.0..1e9).contains(number) => Some(*number as usize),
        Data::String(name) => natural::number(name.rsplit_once('.').map_or(name.as_str(), |(stem, _)| stem)),
        _ => None,
    };
    number.ok_or_else(|| format!("ImageFrame is `{}` where a frame number was expected", shown(cell)))
}

fn finite(cell: &Data, name: &str) -> Result<f64, String> {
    let number = match cell {
        Data::Int(number) => Some(*number as f64),
        Data::Float(number) => Some(*number),
        Data::String(text) => text.trim().parse().ok(),
        _ => None,
    };
    let number = number.filter(|number: &f64| number.is_finite());
    number.ok_or_else(|| format!("{name} is `{}` where a finite number was expected", shown(cell)))
}

fn shown(cell: &Data) -> String {
    cell.to_string().chars().take(32).collect()
}
