//! Trajectories from the paths a user gives: files, run folders, sequence folders, data sets.

use anyhow::anyhow;
use endoscape_eval::poses::{Duplicates, Poses};
use endoscape_eval::{Association, TrajectoryFormat, read};
use endoscape_frames::{FramesError, formats};
use std::path::Path;

/// Trajectories in our run folders and sequence folders.
const OWN_FILES: [&str; 2] = ["trajectory.tum", "poses.tum"];

/// How files are read and poses paired, the same for every evaluation of trajectories.
#[derive(clap::Args)]
pub struct Pairing {
    /// Format of ESTIMATE if it is a file, instead of telling by content: tum, kitti, euroc, csv, npy, npz
    #[arg(long, value_name = "NAME")]
    format: Option<TrajectoryFormat>,
    /// Format of TRUTH if it is a file
    #[arg(long, value_name = "NAME")]
    truth_format: Option<TrajectoryFormat>,
    /// Largest difference in time of two poses that belong together, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = endoscape_eval::associate::DEFAULT_TOLERANCE_S)]
    tolerance: f64,
    /// Interpolate the truth at the times of the estimate
    #[arg(long, conflicts_with = "by_index")]
    interpolate: bool,
    /// Pair first with first, second with second, whatever their times
    #[arg(long)]
    by_index: bool,
    /// Accept poses that share a stamp
    #[arg(long)]
    keep_duplicates: bool,
    /// Trajectories of the training data, whose mean motion the constant baseline repeats [default: the truth's own]
    #[arg(long, value_name = "PATH", num_args = 1..)]
    training: Vec<std::path::PathBuf>,
}

impl Pairing {
    pub const fn association(&self) -> Association {
        let tolerance_s = self.tolerance;
        match (self.by_index, self.interpolate) {
            (true, _) => Association::Order,
            (_, true) => Association::Interpolate { tolerance_s },
            _ => Association::Nearest { tolerance_s },
        }
    }

    /// What happens to poses that share a stamp.
    pub const fn duplicates(&self) -> Duplicates {
        if self.keep_duplicates { Duplicates::Keep } else { Duplicates::Refuse }
    }

    /// The truth at a path.
    pub fn truth(&self, path: &Path) -> anyhow::Result<Poses> {
        poses(path, self.truth_format, self.duplicates())
    }

    /// An estimate at a path.
    pub fn estimate(&self, path: &Path) -> anyhow::Result<Poses> {
        poses(path, self.format, self.duplicates())
    }

    /// Reads both trajectories side by side.
    pub fn read(&self, estimate: &Path, truth: &Path) -> anyhow::Result<(Poses, Poses)> {
        let (estimate, truth) = std::thread::scope(|scope| {
            let other = scope.spawn(|| self.truth(truth));
            let estimate = self.estimate(estimate);
            let truth = other.join().unwrap_or_else(|_| Err(anyhow!("{}: cannot be read", truth.display())));
            (estimate, truth)
        });
        Ok((estimate?, truth?))
    }

    /// Mean motion per frame of the training data; `None` without any.
    pub fn training_motion(&self) -> anyhow::Result<Option<endoscape_eval::MatrixPose>> {
        let mut steps = vec![endoscape_eval::MatrixPose::identity()];
        for path in &self.training {
            let poses = poses(path, None, Duplicates::Refuse)?;
            for pair in poses.world_from_camera().windows(2) {
                let last = steps[steps.len() - 1];
                steps.push(last * pair[0].inv_mul(&pair[1]));
            }
        }
        Ok((!self.training.is_empty()).then(|| endoscape_eval::baselines::mean_motion(&steps)))
    }
}

/// The poses at a path.
pub fn poses(path: &Path, format: Option<TrajectoryFormat>, duplicates: Duplicates) -> anyhow::Result<Poses> {
    let named = |error: endoscape_eval::EvalError| anyhow!("{}: {error}", path.display());
    if !path.is_dir() {
        let bytes = std::fs::read(path).map_err(|error| FramesError::io(path, "read", error))?;
        return read::poses(&bytes, format, duplicates).map_err(named);
    }
    if let Some(own) = OWN_FILES.iter().map(|name| path.join(name)).find(|file| file.is_file()) {
        return poses(&own, Some(TrajectoryFormat::Tum), duplicates);
    }
    let trajectory = formats::open(path, None)?.trajectory()?;
    Poses::from_trajectory(&trajectory).map_err(named)
}
