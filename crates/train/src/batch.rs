//! From snippets in memory to tensors on a device.

use crate::augment::AugmentedFrame;
use crate::augment::planes::Planes;
use crate::dataset::Item;
use crate::error::TrainError;
use crate::lesson::Lessons;
use burn::tensor::{Device, Tensor, TensorData};
use endoscape_core::{Camera, Size};
use endoscape_nets::SCALES;
use endoscape_nets::input::network_range;
use endoscape_synthesis::config::Scales;
use endoscape_synthesis::objective::{View, ViewBatch};
use endoscape_synthesis::{CameraPyramid, ObjectiveConfig, pyramid};

/// Snippets side by side: what the loss compares and what the networks see.
#[derive(Clone, Debug)]
pub struct SnippetBatch {
    /// Pictures, masks and cameras for the loss.
    pub views: ViewBatch,
    /// For the depth network: target, then sources in time order, each `[batch, 3, height, width]`, RGB in [-1, 1].
    pub depth_inputs: Vec<Tensor<4>>,
    /// For the motion network, in the same order.
    pub motion_inputs: Vec<Tensor<4>>,
    /// `[batch]`, 1 where the camera stands still, else 0.
    pub stands: Tensor<1>,
    /// What labels say; `None` where no snippet has any.
    pub lessons: Option<Lessons>,
}

impl SnippetBatch {
    /// Lays snippets of one size and length side by side.
    ///
    /// # Errors
    /// [`TrainError::Synthesis`] for an empty batch or a camera that does not fit.
    pub fn new(items: &[Item], objective: &ObjectiveConfig, device: &Device) -> Result<Self, TrainError> {
        let cameras: Vec<Camera> = items.iter().map(|item| item.snippet.camera).collect();
        let size = cameras.first().map_or(Size::new(0, 0), Camera::size);
        let levels = match objective.scales {
            Scales::Full => 1,
            Scales::Native => SCALES,
        };
        let cameras = CameraPyramid::new(&cameras, &pyramid::sizes(size, levels), objective.camera_scaling, device)?;
        let length = items.first().map_or(0, |item| item.snippet.frames.len());
        let stack = |frame: usize, planes: fn(&AugmentedFrame) -> &Planes| pictures(items, size, frame, planes, device);
        let view = |frame: usize| View {
            image: stack(frame, |frame| &frame.original),
            usable: Some(masks(items, size, frame, device)),
        };
        let stands: Vec<f32> = items.iter().map(|item| f32::from(u8::from(item.stands))).collect();
        Ok(Self {
            stands: Tensor::from_data(TensorData::new(stands, [items.len()]), device),
            lessons: Lessons::new(items, size, device),
            views: ViewBatch { target: view(0), sources: (1..length).map(view).collect(), cameras },
            depth_inputs: (0..length).map(|frame| stack(frame, |frame| &frame.depth_input)).collect(),
            motion_inputs: (0..length).map(|frame| stack(frame, |frame| &frame.motion_input)).collect(),
        })
    }
}

/// One frame of every snippet, `[batch, 3, height, width]`, RGB in [-1, 1].
fn pictures(
    items: &[Item],
    size: Size,
    frame: usize,
    planes: fn(&AugmentedFrame) -> &Planes,
    device: &Device,
) -> Tensor<4> {
    let values =
        items.iter().flat_map(|item| planes(&item.snippet.frames[frame]).values().iter().copied().map(network_range));
    Tensor::from_data(TensorData::new(values.collect::<Vec<f32>>(), [items.len(), 3, size.height, size.width]), device)
}

fn masks(items: &[Item], size: Size, frame: usize, device: &Device) -> Tensor<4> {
    let values: Vec<f32> = items.iter().flat_map(|item| item.snippet.frames[frame].usable.iter().copied()).collect();
    Tensor::from_data(TensorData::new(values, [items.len(), 1, size.height, size.width]), device)
}
