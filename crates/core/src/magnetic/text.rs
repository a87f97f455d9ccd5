//! `magnet.csv`: `index,time_s`, then three columns per sensor, `bK_x_tesla,bK_y_tesla,bK_z_tesla`, K counted from 0.
//!
//! An empty cell or `nan` is a component that was not measured; a sensor without any is a sensor that gave nothing.

use crate::MagneticReading;
use crate::trajectory::{TextError, records};
use nalgebra::Vector3;
use std::fmt::Write as _;

/// Writes readings with digits enough to read back the same numbers. All must have as many sensors as the first.
pub fn to_csv(readings: &[MagneticReading]) -> String {
    let sensors = readings.first().map_or(0, |reading| reading.field_tesla.len());
    std::iter::once(csv_header(sensors)).chain(readings.iter().map(csv_row)).collect()
}

/// The first line of a file of readings, for an array of `sensors` sensors.
pub fn csv_header(sensors: usize) -> String {
    let mut text = String::from("index,time_s");
    for sensor in 0..sensors {
        // Writing to a String cannot fail.
        write!(text, ",b{sensor}_x_tesla,b{sensor}_y_tesla,b{sensor}_z_tesla").ok();
    }
    text + "\n"
}

/// The line of a reading, for files that grow.
pub fn csv_row(reading: &MagneticReading) -> String {
    let mut text = format!("{},{}", reading.index, reading.time_s);
    for field in &reading.field_tesla {
        for component in field.unwrap_or(Vector3::from_element(f64::NAN)).iter() {
            let cell = if component.is_finite() { format!("{component:e}") } else { String::new() };
            write!(text, ",{cell}").ok();
        }
    }
    text + "\n"
}

/// Reads the readings of an array of `sensors` sensors.
///
/// # Errors
/// [`TextError`] at the first line with another number of columns, a cell that is no number, or a time that is not
/// after the one before it.
pub fn parse_csv(text: &str, sensors: usize) -> Result<Vec<MagneticReading>, TextError> {
    let mut readings: Vec<MagneticReading> = Vec::new();
    for (line, record) in records(text).filter(|(_, record)| !record.starts_with("index")) {
        let reading = parse_line(record, sensors).map_err(|reason| TextError { line, reason })?;
        if let Some(last) = readings.last().filter(|last| reading.time_s <= last.time_s) {
            let reason = format!("the time {} s is not after the one before it, {} s", reading.time_s, last.time_s);
            return Err(TextError { line, reason });
        }
        readings.push(reading);
    }
    Ok(readings)
}

fn parse_line(record: &str, sensors: usize) -> Result<MagneticReading, String> {
    let cells: Vec<&str> = record.split(',').map(str::trim).collect();
    let expected = 2 + 3 * sensors;
    if cells.len() != expected {
        let found = cells.len();
        return Err(format!(
            "found {found} columns where {expected} were expected: index, time_s and 3 for each of {sensors} sensors"
        ));
    }
    let index = cells[0].parse().map_err(|_| format!("`{}` is no index", shown(cells[0])))?;
    let time_s = number(cells[1])?;
    if !time_s.is_finite() {
        return Err(format!("the time is `{}`", shown(cells[1])));
    }
    let field_tesla = cells[2..].chunks_exact(3).map(|cells| {
        let field = Vector3::new(number(cells[0])?, number(cells[1])?, number(cells[2])?);
        Ok(field.iter().any(|component| component.is_finite()).then_some(field))
    });
    Ok(MagneticReading { index, time_s, field_tesla: field_tesla.collect::<Result<_, String>>()? })
}

/// A number, NaN for an empty cell.
fn number(cell: &str) -> Result<f64, String> {
    if cell.is_empty() { Ok(f64::NAN) } else { cell.parse().map_err(|_| format!("`{}` is no number", shown(cell))) }
}

fn shown(cell: &str) -> String {
    cell.chars().take(32).collect()
}
