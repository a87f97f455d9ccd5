//! A contact sheet: what the frames look like, how deep they are, where the camera sees.

use endoscape_core::{DepthMap, Image, Mask, Size};

/// Width of one thumbnail in pixels.
const THUMBNAIL_WIDTH: usize = 240;

/// Space between thumbnails in pixels.
const GAP: usize = 4;

/// Darkening of pixels outside the field of view, and the colour laid over them.
const OUTSIDE_TINT: [u8; 3] = [200, 30, 60];

/// One column of the sheet.
#[derive(Clone, Debug)]
pub struct Panel {
    /// The frame.
    pub image: Image,
    /// Its depth, where it has any.
    pub depth: Option<DepthMap>,
}

/// Frames on top, their depth below (dark blue is near, yellow is far, black unknown, one scale for all), and at the
/// bottom the frames with everything outside the field of view tinted red.
pub fn contact_sheet(panels: &[Panel], field_of_view: Option<&Mask>) -> Image {
    let Some(first) = panels.first() else { return Image::from_fn(Size::new(1, 1), |_, _| [0; 3]) };
    let from = first.image.size();
    let height = (THUMBNAIL_WIDTH * from.height).div_ceil(from.width).max(1);
    let cell = Size::new(THUMBNAIL_WIDTH, height);
    let range = depth_range(panels);
    let size = Size::new(panels.len() * (cell.width + GAP) + GAP, 3 * (cell.height + GAP) + GAP);
    Image::from_fn(size, |x, y| {
        let ((column, u), (row, v)) = (cell_of(x, cell.width), cell_of(y, cell.height));
        let (Some(u), Some(v), Some(panel)) = (u, v, panels.get(column)) else { return [255; 3] };
        let (px, py) = (u * from.width / cell.width, v * from.height / cell.height);
        match row {
            0 => panel.image.get(px, py).unwrap_or_default(),
            1 => depth_colour(panel.depth.as_ref(), px, py, range),
            _ => tinted(panel.image.get(px, py).unwrap_or_default(), field_of_view, px, py),
        }
    })
}

/// Which cell a coordinate falls into, and where inside it; `None` in the gap.
fn cell_of(at: usize, extent: usize) -> (usize, Option<usize>) {
    (at / (extent + GAP), (at % (extent + GAP)).checked_sub(GAP))
}

/// Depth from the 2nd to the 98th percentile of all panels, so that a few outliers do not flatten the colours.
fn depth_range(panels: &[Panel]) -> (f32, f32) {
    let depths = panels.iter().filter_map(|panel| panel.depth.as_ref());
    let mut known: Vec<f32> =
        depths.flat_map(|depth| depth.grid().values().iter().step_by(31).copied()).filter(|depth| *depth > 0.0).collect();
    known.sort_by(f32::total_cmp);
    let at = |share: f64| known.get((known.len().saturating_sub(1) as f64 * share) as usize).copied().unwrap_or(1.0);
    (at(0.02), at(0.98))
}

fn depth_colour(depth: Option<&DepthMap>, x: usize, y: usize, (near, far): (f32, f32)) -> [u8; 3] {
    let Some(depth) = depth.and_then(|depth| depth.get(x, y)) else { return [0; 3] };
    let share = ((depth - near) / (far - near).max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
    let colour = colorous::VIRIDIS.eval_continuous(f64::from(share));
    [colour.r, colour.g, colour.b]
}

fn tinted(colour: [u8; 3], field_of_view: Option<&Mask>, x: usize, y: usize) -> [u8; 3] {
    let outside = field_of_view.is_some_and(|mask| mask.get(x, y) == Some(&false));
    if !outside {
        return colour;
    }
    let mix = |value: u8, tint: u8| value / 2 + tint / 2;
    [mix(colour[0], OUTSIDE_TINT[0]), mix(colour[1], OUTSIDE_TINT[1]), mix(colour[2], OUTSIDE_TINT[2])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use endoscape_core::Grid;

    #[test]
    fn the_three_rows_show_frame_depth_and_field_of_view() {
        let size = Size::new(240, 120);
        let depth = DepthMap::new(Grid::from_fn(size, |x, _| if x < 120 { 0.01 } else { 0.0 }));
        let panel = Panel { image: Image::from_fn(size, |_, _| [100; 3]), depth: Some(depth) };
        let mask = Grid::from_fn(size, |x, _| x < 120);
        let sheet = contact_sheet(&[panel], Some(&mask));
        assert_eq!(sheet.size(), Size::new(248, 376));
        assert_eq!(sheet.get(10, 10), Some([100; 3]));
        assert_ne!(sheet.get(10, 140), Some([0; 3]));
        assert_eq!(sheet.get(230, 140), Some([0; 3]));
        assert_eq!(sheet.get(10, 260), Some([100; 3]));
        assert_eq!(sheet.get(230, 260), Some([150, 65, 80]));
        assert_eq!(sheet.get(0, 0), Some([255; 3]));
    }
}
