//! The products that make a picture: every output pixel is a sum over input channels and taps.
//!
//! Both directions of a convolution become the same sum (`shape.rs`). Going from the small to the large picture with
//! stride 2, output pixels of even and odd rows and columns see different taps: they are four passes over the same
//! input, whose results are interleaved when they are stored. There are three ways to compute the sums:
//!
//! - directly (`direct.rs`): a panel of output channels and a tile of pixels at a time, each sum in registers from its
//!   first product to its last; the input is laid out with zeros around it (`planes.rs`), so that a tap is a constant
//!   offset from a position;
//! - directly as well, but with vectors along channels in the place of pixels (`deep.rs`);
//! - by Winograd's filtering (`winograd.rs`): tiles of 6 x 6 or 8 x 8 input pixels become as many numbers whose
//!   products with transformed weights need up to five times fewer multiplications.

mod deep;
mod direct;
mod pieces;
mod shape;
mod winograd;

use crate::geometry::Geometry;
use crate::level::Level;
use crate::memory::at_least;
use crate::share::share;
use pieces::{Panel, Task};
use rayon::prelude::*;
use shape::Shape;

/// Operations below which handing work to another thread takes longer than doing it.
const WORTH_SHARING: usize = 500_000;

/// What happens to a sum before it is stored.
#[derive(Clone, Copy, Debug, Default)]
pub struct Epilogue<'a> {
    /// Added to each channel.
    pub bias: Option<&'a [f32]>,
    /// Whether negative results become zero.
    pub relu: bool,
}

/// Memory that is used again from call to call.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    planes: Vec<f32>,
}

/// Weights in the order in which a [`Correlation`] reads them.
#[derive(Clone, Debug, Default)]
pub struct PackedWeights {
    panels: Vec<Panel>,
    /// At least as many as are used: memory never shrinks from one packing to the next.
    values: Vec<f32>,
    length: usize,
}

/// How sums are computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Product by product.
    Direct,
    /// Product by product, with vectors along output channels, for few pixels with many channels.
    Deep,
    /// By Winograd's filtering of tiles of 6 x 6 pixels.
    Winograd6,
    /// By Winograd's filtering of tiles of 8 x 8 pixels.
    Winograd8,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Direct, Self::Deep, Self::Winograd6, Self::Winograd8];

    /// Pairs of points that Winograd's filtering uses.
    pub(crate) fn pairs(self) -> Option<usize> {
        match self {
            Self::Direct | Self::Deep => None,
            Self::Winograd6 => Some(2),
            Self::Winograd8 => Some(3),
        }
    }
}

/// One direction of a convolution, prepared for its sizes.
#[derive(Clone, Debug)]
pub struct Correlation {
    level: Level,
    shape: Shape,
    method: Method,
    plan: Plan,
}

#[derive(Clone, Debug)]
enum Plan {
    Direct(direct::Plan),
    Deep(deep::Plan),
    Winograd(winograd::Plan),
}

impl Plan {
    /// `None` where the method cannot compute the product.
    fn new(shape: &Shape, method: Method) -> Option<Self> {
        match method {
            Method::Direct => Some(Self::Direct(direct::Plan::new(shape))),
            Method::Deep => deep::Plan::new(shape).map(Self::Deep),
            Method::Winograd6 | Method::Winograd8 => winograd::Plan::new(shape, method).map(Self::Winograd),
        }
    }

    /// About how long it takes, in multiplications.
    fn cost(&self, shape: &Shape, level: Level) -> f64 {
        match self {
            Self::Direct(plan) => plan.cost(shape, level),
            Self::Deep(plan) => plan.cost(shape, level),
            Self::Winograd(plan) => plan.cost(shape),
        }
    }

    /// Numbers in the weights of an output channel.
    fn weights_of_a_channel(&self, shape: &Shape) -> usize {
        match self {
            Self::Direct(plan) | Self::Deep(deep::Plan { direct: plan, .. }) => plan.weights_of_a_channel(shape),
            Self::Winograd(plan) => plan.weights_of_a_channel(shape),
        }
    }
}

impl Correlation {
    /// From the large to the small picture: a convolution, or the data gradient of a transposed one.
    pub fn to_small(geometry: &Geometry, level: Level) -> Self {
        Self::fastest(Shape::to_small(geometry), level)
    }

    /// From the small to the large picture: a transposed convolution, or the data gradient of a convolution.
    pub fn to_large(geometry: &Geometry, level: Level) -> Self {
        Self::fastest(Shape::to_large(geometry), level)
    }

    fn fastest(shape: Shape, level: Level) -> Self {
        assert!(matches!(shape.geometry.stride, 1 | 2), "strides are 1 or 2");
        let (mut least, mut fastest) = (f64::INFINITY, (Method::Direct, Plan::Direct(direct::Plan::new(&shape))));
        for method in Method::ALL {
            let Some(plan) = Plan::new(&shape, method) else { continue };
            let cost = plan.cost(&shape, level);
            if cost < least {
                (least, fastest) = (cost, (method, plan));
            }
        }
        Self { level, shape, method: fastest.0, plan: fastest.1 }
    }

    /// The same product by another method; by the one it has where that one cannot compute it.
    #[must_use]
    pub fn by(self, method: Method) -> Self {
        match Plan::new(&self.shape, method) {
            Some(plan) => Self { method, plan, ..self },
            None => self,
        }
    }

    /// The convolution's sizes.
    pub fn geometry(&self) -> &Geometry {
        &self.shape.geometry
    }

    /// How it is computed.
    pub fn method(&self) -> Method {
        self.method
    }

    /// Brings weights, `[small channels, large channels, kernel, kernel]`, into the order they are read in.
    ///
    /// # Panics
    /// If their number is not the geometry's.
    pub fn pack(&self, weights: &[f32]) -> PackedWeights {
        let mut packed = PackedWeights::default();
        self.pack_into(weights, &mut packed);
        packed
    }

    /// As [`Self::pack`], into memory that is used again.
    ///
    /// # Panics
    /// If the number of weights is not the geometry's.
    pub fn pack_into(&self, weights: &[f32], packed: &mut PackedWeights) {
        assert_eq!(weights.len(), self.shape.geometry.weights(), "weights of {:?}", self.shape.geometry);
        let of_a_channel = self.weights_of_a_channel();
        packed.panels = match &self.plan {
            Plan::Deep(_) => pieces::panels(self.shape.outputs, &[deep::Plan::width(self.level)], of_a_channel),
            _ => pieces::panels(self.shape.outputs, self.level.panel_widths(), of_a_channel),
        };
        packed.length = self.packed_length(packed);
        let mut rest = at_least(&mut packed.values, packed.length);
        let mut parts = Vec::with_capacity(packed.panels.len());
        for panel in &packed.panels {
            let (part, after) = rest.split_at_mut(panel.width * of_a_channel);
            parts.push((panel, part));
            rest = after;
        }
        parts.into_par_iter().for_each(|(panel, part)| match &self.plan {
            Plan::Direct(plan) | Plan::Deep(deep::Plan { direct: plan, .. }) => {
                plan.pack(&self.shape, weights, panel, part);
            }
            Plan::Winograd(plan) => {
                self.level.run(winograd::Pack { plan, shape: &self.shape, weights, panel, values: part });
            }
        });
    }

    fn weights_of_a_channel(&self) -> usize {
        self.plan.weights_of_a_channel(&self.shape)
    }

    fn packed_length(&self, packed: &PackedWeights) -> usize {
        packed.panels.last().map_or(0, |panel| panel.start + panel.width * self.weights_of_a_channel())
    }

    /// Computes the product for a batch of pictures.
    ///
    /// # Shapes
    /// - `input`: `[batch, channels, height, width]`, of the large picture for [`Self::to_small`], else of the small one
    /// - `output`: as many pictures of the other one; all of it is written
    ///
    /// # Panics
    /// If lengths do not fit the geometry, or `weights` were packed for another one.
    pub fn run(
        &self,
        input: &[f32],
        weights: &PackedWeights,
        epilogue: Epilogue<'_>,
        output: &mut [f32],
        workspace: &mut Workspace,
    ) {
        let [from, to] = [self.shape.input_length(), self.shape.output_length()];
        assert!(input.len().is_multiple_of(from), "input of {:?}", self.shape.geometry);
        assert_eq!(output.len(), input.len() / from * to, "output of {:?}", self.shape.geometry);
        assert_eq!(weights.length, self.packed_length(weights), "weights of {:?}", self.shape.geometry);
        let (shape, level, pictures) = (&self.shape, self.level, input.len() / from);
        let operations = pictures * shape.geometry.operations();
        match &self.plan {
            Plan::Direct(plan) => {
                plan.source.fill(level, input, &mut workspace.planes);
                let work = direct::Work { shape, plan, source: &workspace.planes, weights, epilogue };
                let tasks = work.cut(pictures).tasks(shape, &weights.panels, output);
                share_if_worth(operations, tasks, |task| level.run(direct::Run { work: &work, task }));
            }
            Plan::Deep(plan) => {
                let work = deep::Work { shape, plan, pictures: input, weights, epilogue };
                let tasks = work.cut(pictures).tasks(shape, &weights.panels, output);
                share_if_worth(operations, tasks, |task| level.run(deep::Run { work: &work, task }));
            }
            Plan::Winograd(plan) => {
                let work = winograd::Work { shape, plan, level, pictures: input, weights, epilogue };
                let tasks = work.cut(pictures).tasks(shape, &weights.panels, output);
                share_if_worth(operations, tasks, |task| level.run(winograd::Run { work: &work, task }));
            }
        }
    }
}

/// Does all tasks, on several threads if that is worth it.
fn share_if_worth<'a>(operations: usize, tasks: Vec<Task<'a>>, run: impl Fn(Task<'a>) + Sync) {
    if operations < WORTH_SHARING {
        tasks.into_iter().for_each(run);
    } else {
        share(tasks, run);
    }
}
