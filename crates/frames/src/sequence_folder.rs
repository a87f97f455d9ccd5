//! Our own sequence folder, written in one piece.
