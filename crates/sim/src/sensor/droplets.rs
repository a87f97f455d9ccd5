//! Drops of water on the window: small lenses that show the picture shrunken and upside down, and crawl down slowly.

use super::Light;
use crate::random::{Key, Wander};
use endoscape_core::Size;

/// Drops on the window at any time.
const DROPS: u64 = 7;
/// How much of the picture a drop shows across its width.
const SHRUNKEN: f64 = 3.2;

struct Droplet {
    x: f64,
    y: f64,
    radius: f64,
}

/// Lays the drops over the picture and notes what they cover.
pub fn cling(light: &mut Light, cover: &mut [f32], size: Size, key: Key, time_s: f64) {
    let dry = light.clone();
    for drop in (0..DROPS).map(|i| at_time(key.at(i), size, time_s)) {
        let reach = drop.radius.ceil();
        let rows = ((drop.y - reach).max(0.0) as usize)..((drop.y + reach).max(0.0) as usize + 1).min(size.height);
        for y in rows {
            for x in ((drop.x - reach).max(0.0) as usize)..((drop.x + reach).max(0.0) as usize + 1).min(size.width) {
                let Some((colour, edge)) = refract(&dry, size, &drop, (x, y)) else { continue };
                let at = y * size.width + x;
                light[at] = std::array::from_fn(|c| light[at][c] * (1.0 - edge) + colour[c] * edge);
                cover[at] = cover[at].max(edge);
            }
        }
    }
}

/// What a drop shows in a pixel, and how much of the pixel it covers; `None` beside the drop.
fn refract(dry: &Light, size: Size, drop: &Droplet, (x, y): (usize, usize)) -> Option<([f32; 3], f32)> {
    let (dx, dy) = ((x as f64 - drop.x) / drop.radius, (y as f64 - drop.y) / drop.radius);
    let share = dx.hypot(dy);
    if share >= 1.0 {
        return None;
    }
    // Upside down, wider towards the rim, as through a ball.
    let bend = SHRUNKEN * drop.radius * (1.0 + share * share);
    let from =
        |middle: f64, offset: f64, extent: usize| (middle - bend * offset).clamp(0.0, (extent - 1) as f64) as usize;
    let source = dry[from(drop.y, dy, size.height) * size.width + from(drop.x, dx, size.width)];
    // A dark rim, and a soft edge where the film of water thins out.
    let rim = (1.0 - 0.55 * share.powi(6)) as f32;
    let edge = (((1.0 - share) * drop.radius) / 1.5).min(1.0) as f32;
    Some((source.map(|value| value * rim), edge))
}

fn at_time(key: Key, size: Size, time_s: f64) -> Droplet {
    let mut series = key.series();
    let (width, height) = (size.width as f64, size.height as f64);
    let (x, y) = (series.range(0.1, 0.9) * width, series.range(-0.1, 1.1) * height);
    let radius = series.range(0.025, 0.075) * width;
    let crawl = series.range(0.001, 0.01) * height;
    let wobble = Wander::new(series.key(), 5.0);
    let y = (y + crawl * time_s + radius).rem_euclid(height + 2.0 * radius) - radius;
    Droplet { x: x + 0.006 * width * wobble.at(time_s), y, radius }
}
