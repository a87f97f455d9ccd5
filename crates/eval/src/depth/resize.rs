//! Bilinear resizing of depth maps.

use crate::EvalError;
use endoscape_core::{DepthMap, Grid, Size};

/// Aspect ratios may differ by this much: networks round sizes (416x128 for 1242x375 is 1.9 % off).
const ASPECT_TOLERANCE: f64 = 0.05;

/// The map at another size, pixel areas laid over each other (the map covers `-0.5 .. W - 0.5` at both sizes), as
/// OpenCV's `INTER_LINEAR` does. Unknown neighbours have no weight; a pixel without known ones stays unknown.
///
/// # Errors
/// [`EvalError::Shape`] if the aspect ratios differ by more than 5 % or a size is empty.
pub fn resize_to(map: &DepthMap, size: Size) -> Result<DepthMap, EvalError> {
    let from = map.size();
    if from == size {
        return Ok(map.clone());
    }
    // An empty size gives infinity or NaN, neither of which is close.
    let aspect = (from.width * size.height) as f64 / (from.height * size.width) as f64;
    let close = (aspect - 1.0).abs() <= ASPECT_TOLERANCE;
    if !close {
        return Err(EvalError::Shape { prediction: from, truth: size });
    }
    let columns: Vec<Tap> = (0..size.width).map(|x| Tap::of(x, size.width, from.width)).collect();
    let rows: Vec<Tap> = (0..size.height).map(|y| Tap::of(y, size.height, from.height)).collect();
    Ok(DepthMap::new(Grid::from_fn(size, |x, y| mixed(map, &columns[x], &rows[y]))))
}

/// Two neighbours and the weight of the second.
struct Tap {
    first: usize,
    second: usize,
    weight: f32,
}

impl Tap {
    fn of(target: usize, target_extent: usize, source_extent: usize) -> Self {
        let step = source_extent as f64 / target_extent as f64;
        let last = source_extent.saturating_sub(1);
        let position = ((target as f64 + 0.5) * step - 0.5).clamp(0.0, last as f64);
        let first = position.floor() as usize;
        Self { first, second: (first + 1).min(last), weight: (position - position.floor()) as f32 }
    }
}

fn mixed(map: &DepthMap, column: &Tap, row: &Tap) -> f32 {
    let taps = [
        (column.first, row.first, (1.0 - column.weight) * (1.0 - row.weight)),
        (column.second, row.first, column.weight * (1.0 - row.weight)),
        (column.first, row.second, (1.0 - column.weight) * row.weight),
        (column.second, row.second, column.weight * row.weight),
    ];
    let known = taps.into_iter().filter_map(|(x, y, weight)| map.get(x, y).map(|depth| (depth * weight, weight)));
    let (sum, weight) = known.fold((0.0, 0.0), |(sum, total), (depth, weight)| (sum + depth, total + weight));
    if weight > 0.0 { sum / weight } else { DepthMap::UNKNOWN }
}
