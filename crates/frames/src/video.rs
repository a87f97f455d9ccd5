//! Video files and live inputs through an `ffmpeg` process.
