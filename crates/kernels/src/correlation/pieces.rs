//! Cutting a product into pieces of work that write apart from each other.

use super::shape::Shape;
use std::ops::Range;

/// Output channels computed side by side, and where their weights begin.
#[derive(Clone, Debug)]
pub struct Panel {
    pub channels: Range<usize>,
    /// How many channels the innermost loop computes; beyond those of the panel the weights are zero.
    pub width: usize,
    pub start: usize,
}

/// Panels of all channels, of the widths given, widest first; a channel has `weights` numbers.
pub fn panels(channels: usize, widths: &[usize], weights: usize) -> Vec<Panel> {
    let (mut panels, mut channel, mut start) = (Vec::new(), 0, 0);
    while channel < channels {
        let left = channels - channel;
        // The narrowest panel that takes all that is left, else the widest.
        let width = *widths.iter().rev().find(|width| **width >= left).unwrap_or(&widths[0]);
        panels.push(Panel { channels: channel..channel + width.min(left), width, start });
        channel += width;
        start += width * weights;
    }
    panels
}

/// How a product is cut.
pub struct Cut {
    /// Pieces of a picture, of whole rows of positions, and the rows of the output that belong to one of those.
    pub pieces: usize,
    pub lines_per_row: usize,
    /// Rows of positions of a picture.
    pub grid_rows: usize,
    pub segments_per_task: usize,
    pub panels_per_task: usize,
}

/// Some panels of some rows.
pub struct Task<'a> {
    pub panels: Range<usize>,
    pub segments: Vec<Segment<'a>>,
}

/// Rows of one picture, as far as a task writes them.
pub struct Segment<'a> {
    pub picture: usize,
    /// First row of positions, and how many.
    pub first_row: usize,
    pub rows: usize,
    /// The rows of each channel of the task's panels.
    pub channels: Vec<&'a mut [f32]>,
}

impl Cut {
    /// Where a piece of a picture begins: they differ by one row at most.
    fn first_row(&self, piece: usize) -> usize {
        let (rows, longer) = (self.grid_rows / self.pieces, self.grid_rows % self.pieces);
        piece * rows + piece.min(longer)
    }

    /// Pieces that together write all of `output`.
    pub fn tasks<'a>(&self, shape: &Shape, panels: &[Panel], output: &'a mut [f32]) -> Vec<Task<'a>> {
        let Self { pieces: per_picture, lines_per_row, segments_per_task, panels_per_task, .. } = *self;
        let pictures = output.len() / shape.output_length().max(1);
        let width = panels.first().map_or(1, |panel| panel.width);
        let segment_groups = (pictures * per_picture).div_ceil(segments_per_task);
        let panel_groups = panels.len().div_ceil(panels_per_task);
        let task = |index: usize| {
            let (segments, group) = (index / panel_groups, index % panel_groups);
            let segments =
                segments * segments_per_task..((segments + 1) * segments_per_task).min(pictures * per_picture);
            let panels = group * panels_per_task..((group + 1) * panels_per_task).min(panels.len());
            let segment = |segment: usize| {
                let first_row = self.first_row(segment % per_picture);
                let rows = self.first_row(segment % per_picture + 1) - first_row;
                let channels = Vec::with_capacity(panels.len() * width);
                Segment { picture: segment / per_picture, first_row, rows, channels }
            };
            Task { segments: segments.map(segment).collect(), panels: panels.clone() }
        };
        let mut tasks: Vec<Task<'a>> = (0..segment_groups * panel_groups).map(task).collect();
        for (index, plane) in output.chunks_mut(shape.size[0] * shape.size[1]).enumerate() {
            let (picture, channel) = (index / shape.outputs, index % shape.outputs);
            let mut rest = plane;
            for piece in 0..per_picture {
                let rows = self.first_row(piece + 1) - self.first_row(piece);
                // The last rows of positions may lie beyond the picture.
                let length = (rows * lines_per_row * shape.size[1]).min(rest.len());
                let (lines, after) = rest.split_at_mut(length);
                rest = after;
                let segment = picture * per_picture + piece;
                let group = segment / segments_per_task * panel_groups + channel / width / panels_per_task;
                tasks[group].segments[segment % segments_per_task].channels.push(lines);
            }
        }
        tasks
    }
}
