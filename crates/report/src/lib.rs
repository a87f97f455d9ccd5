//! Results as figures, tables and words: one HTML page that needs nothing else, and the same figures as files.
//!
//! ```text
//! trajectories, run folders, sequence -> study::judge -> Study
//!     Study -> figures::of -> Figure -> page (inline SVG), figures/*.svg, *.png, *.csv
//!           -> tables, verdict, wins -> page, compare.json
//! ```
//!
//! | module | what |
//! |---|---|
//! | [`run_folder`], [`maps`] | what methods left behind, read |
//! | [`study`] | everything a report says, as values |
//! | [`wins`] | which method is better, and whether that could be luck |
//! | [`figure`] | drawing: charts, pictures, SVG, PNG |
//! | [`figures`] | the figures of a report |
//! | [`tables`], [`table`] | its tables |
//! | [`verdict`] | its words |
//! | [`page`] | the HTML |
//! | [`mod@write`] | everything into files |
//! | `recording` (feature `rerun`) | the same results over time, for the Rerun viewer |
//!
//! All of it is deterministic: the same input gives the same bytes.

pub mod depth_study;
pub mod error;
pub mod figure;
pub mod figures;
pub mod maps;
pub mod mask_study;
pub mod page;
#[cfg(feature = "rerun")]
pub mod recording;
pub mod run_folder;
pub mod study;
pub mod summary;
pub mod table;
pub mod tables;
pub mod verdict;
pub mod wins;
pub mod write;

pub use error::ReportError;
pub use run_folder::RunFolder;
pub use study::{MethodInput, SequenceInput, Study, judge};
pub use write::{judge_run, run_report, write_comparison, write_run};
