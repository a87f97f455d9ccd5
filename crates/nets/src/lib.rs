//! DispNet and PoseMaskNet, their checkpoints, and weights in and out.
