//! View synthesis and the losses that train on it.
