//! Trajectory and depth metrics: association, alignment, errors, baselines, intervals. Pure functions.
