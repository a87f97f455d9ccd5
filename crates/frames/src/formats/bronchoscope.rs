//! Clips of a robot-driven bronchoscope in an airway phantom: `frameVideo.mp4` with `state.csv`.
//!
//! The video shows the endoscope in its left square half and an outside view in the right one; only the left is used.
//! It plays faster than it was taken, so the times come from column `t_s` of `state.csv`, one row per frame. The
//! other columns are the robot's bend, rotation and insertion, which are no pose of the camera.

use super::{Format, Probe, common};
use crate::sequence::{ImageLocation, VideoFile};
use crate::{FrameEntry, FramesError, Sequence};
use endoscape_core::trajectory::{TextError, records};
use endoscape_core::{Rect, Size};
use std::path::Path;

/// Answers whether `path` holds this format, and loads it.
pub fn probe(path: &Path) -> Probe {
    if recognised(path) { Some(load(path)) } else { common::only_sequence(path, recognised, load) }
}

fn recognised(path: &Path) -> bool {
    ["frameVideo.mp4", "state.csv"].iter().all(|name| path.join(name).is_file())
}

fn load(path: &Path) -> Result<Sequence, FramesError> {
    let mut warnings = vec!["no calibration is published: give the camera with --camera FILE or --hfov".into()];
    let table = path.join("state.csv");
    let times_s = parse_state(&common::read_text(&table)?).map_err(|error| (table.as_path(), error))?;
    let video = path.join("frameVideo.mp4");
    let info = crate::video::probe(&video)?;
    let crop = endoscope_half(info.size);
    let count = info.frames.unwrap_or(times_s.len());
    if count != times_s.len() {
        warnings.push(format!(
            "the video has {count} frames but state.csv {} rows: the first {} of both are used",
            times_s.len(),
            count.min(times_s.len())
        ));
    }
    let frames = frames(&times_s[..count.min(times_s.len())]);
    if frames.is_empty() {
        return Err(FramesError::file(&table, "has no row for any frame of the video", "fetch the clip again"));
    }
    Ok(Sequence {
        format: Format::Bronchoscope,
        name: common::name_of(path),
        root: path.to_path_buf(),
        size: crop.map_or(info.size, |crop| crop.size),
        fps: mean_rate(&times_s),
        camera: None,
        video: Some(VideoFile { path: video, crop }),
        frames,
        license: None,
        warnings,
    })
}

/// The left half where the picture is two squares side by side, else all of it.
fn endoscope_half(size: Size) -> Option<Rect> {
    let square = Size::new(size.height, size.height);
    (size.width == 2 * size.height).then_some(Rect { x: 0, y: 0, size: square })
}

fn frames(times_s: &[f64]) -> Vec<FrameEntry> {
    let frame = |(number, time_s): (usize, &f64)| FrameEntry {
        number,
        time_s: *time_s,
        image: ImageLocation::Video(number),
        depth: None,
        mask: None,
        world_from_camera: None,
    };
    times_s.iter().enumerate().map(frame).collect()
}

/// Frames per second as they were taken, on average.
fn mean_rate(times_s: &[f64]) -> Option<f64> {
    let (first, last) = (times_s.first()?, times_s.last()?);
    (last > first).then(|| (times_s.len() - 1) as f64 / (last - first))
}

/// Reads column `t_s` of `state.csv`: seconds, one row per frame, increasing.
///
/// # Errors
/// [`TextError`] at the header if it has no such column, or at the first row that has another number of columns than
/// the header, no finite time, or a time not after the one before it.
pub fn parse_state(text: &str) -> Result<Vec<f64>, TextError> {
    let mut rows = records(text);
    let (line, header) = rows.next().unwrap_or((1, ""));
    let columns = header.split(',').count();
    let column = header.split(',').position(|name| name.trim() == "t_s");
    let column = column.ok_or_else(|| TextError { line, reason: "the header has no column t_s".into() })?;
    let timed = rows.map(|(line, row)| {
        let found = row.split(',').count();
        if found != columns {
            return Err(TextError { line, reason: format!("has {found} columns where the header has {columns}") });
        }
        let time =
            row.split(',').nth(column).and_then(|field| field.trim().parse().ok()).filter(|t: &f64| t.is_finite());
        time.map(|time_s| (line, time_s)).ok_or_else(|| TextError { line, reason: "t_s is not a finite number".into() })
    });
    let timed = timed.collect::<Result<Vec<_>, _>>()?;
    common::increasing(timed.iter().copied())?;
    Ok(timed.into_iter().map(|(_, time_s)| time_s).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::fixtures::{loaded, refusal, shared, text};
    use proptest::prelude::*;

    const STATE: &str = "frame,t_s,bend_deg\n0,0.001,-17\n1,0.290,-17\n2,0.507,-16\n";

    #[test]
    fn times_are_those_of_the_table() {
        assert_eq!(parse_state(STATE).unwrap(), [0.001, 0.290, 0.507]);
        assert!((mean_rate(&[0.0, 0.3, 0.6]).unwrap() - 1.0 / 0.3).abs() < 1e-12);
        assert_eq!((mean_rate(&[1.0]), mean_rate(&[])), (None, None));
    }

    #[test]
    fn the_left_square_is_the_endoscope() {
        let half = Rect { x: 0, y: 0, size: Size::new(400, 400) };
        assert_eq!(endoscope_half(Size::new(800, 400)), Some(half));
        assert_eq!(endoscope_half(Size::new(640, 480)), None);
    }

    #[test]
    fn the_first_wrong_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        text(&folder.path().join("state.csv"), STATE);
        assert!(probe(folder.path()).is_none());
        text(&folder.path().join("frameVideo.mp4"), "");
        let attempts = [
            ("frame,time\n0,1\n", "state.csv, line 1: the header has no column t_s"),
            ("", "state.csv, line 1: the header has no column t_s"),
            ("frame,t_s\n0,0.1\n1\n", "state.csv, line 3: has 1 columns where the header has 2"),
            ("frame,t_s\n0,0.1\n1,0.1\n", "state.csv, line 3: the time 0.1 s does not come after 0.1 s"),
            ("frame,t_s\n0,inf\n", "state.csv, line 2: t_s is not a finite number"),
        ];
        for (wrong, sentence) in attempts {
            text(&folder.path().join("state.csv"), wrong);
            let error = refusal(probe(folder.path()));
            assert!(error.contains(sentence), "{error}");
        }
    }

    #[test]
    fn the_real_clips_load() {
        let Some(folder) = shared("bronchoscope-phantom") else { return };
        let mut clips: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        clips.sort();
        assert_eq!(clips.len(), 17);
        // Asking for the size starts a process per clip; three of them are enough.
        for (clip, frames) in clips.iter().zip([348, 234, 371]) {
            let sequence = loaded(probe(clip));
            assert_eq!((sequence.frames.len(), sequence.size), (frames, Size::new(400, 400)));
            assert!((3.0..4.5).contains(&sequence.fps.unwrap()), "{:?}", sequence.fps);
            assert_eq!(sequence.warnings.len(), 1, "{:?}", sequence.warnings);
        }
        let rows = |clip: &std::path::PathBuf| {
            parse_state(&common::read_text(&clip.join("state.csv")).unwrap()).unwrap().len()
        };
        assert_eq!(clips.iter().map(rows).sum::<usize>(), 5529);
    }

    proptest! {
        #[test]
        fn any_text_is_answered(rows in "[-0-9eE., \n]{0,100}") {
            let _ = parse_state(&format!("frame,t_s\n{rows}"));
        }
    }
}
