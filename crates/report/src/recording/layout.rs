//! Where things are in a recording, and how the viewer lays them out.

use super::moment::Clock;
use super::optics::recorded_size;
use crate::RunFolder;
use crate::figure::Ink;
use crate::study::{MethodStudy, SequenceStudy, Study};
use endoscape_core::{Camera, Size};
use endoscape_frames::Sequence;
use re_sdk::EntityPath;
use re_sdk::blueprint::{
    Blueprint, BlueprintPanel, ContainerLike, Grid, Horizontal, SelectionPanel, Spatial2DView, Spatial3DView, Tabs,
    TextLogView, TimePanel, TimeSeriesView, Vertical, components::PanelState,
};
use re_sdk_types::components::Color;

/// One sequence of a study with its frames.
pub(super) struct Scene<'a> {
    pub study: &'a SequenceStudy,
    pub sequence: Option<&'a Sequence>,
    pub clock: Clock,
}

/// The sequences of a study with their frames.
pub(super) fn scenes<'a>(study: &'a Study, sequences: &[Option<&'a Sequence>]) -> Vec<Scene<'a>> {
    let sequences = sequences.iter().copied().chain(std::iter::repeat(None));
    let scene = |(study, sequence): (&'a SequenceStudy, Option<&'a Sequence>)| {
        let sequence = sequence.filter(|sequence| !sequence.is_live());
        Scene { study, sequence, clock: Clock::of(study, sequence) }
    };
    study.sequences.iter().zip(sequences).map(scene).collect()
}

impl Scene<'_> {
    fn root(&self) -> EntityPath {
        EntityPath::from_single_string(self.study.name.as_str())
    }

    /// Where the truth is.
    pub(super) fn truth(&self) -> EntityPath {
        self.root().join(&"truth".into())
    }

    /// Where a method is. Those called `truth` share its place, which only a user who wants it so can bring about.
    pub(super) fn method(&self, method: &MethodStudy) -> EntityPath {
        self.root().join(&EntityPath::from_single_string(method.name.as_str()))
    }

    /// Where its confidence is.
    pub(super) fn confidence(&self, method: &MethodStudy) -> EntityPath {
        self.method(method).join(&"confidence".into())
    }

    /// Where the error of its position is, millimetres.
    pub(super) fn error(&self, method: &MethodStudy) -> EntityPath {
        self.method(method).join(&"error_mm".into())
    }

    /// The camera of the pictures as they are recorded.
    pub(super) fn picture_camera(&self) -> Option<Camera> {
        let camera = self.sequence?.camera?;
        camera.scaled_to(recorded_size(camera.size())).ok()
    }

    /// The camera of a method's maps.
    pub(super) fn map_camera(&self, run: &RunFolder, size: Size) -> Option<Camera> {
        let camera = run.facts.depth.camera.or_else(|| self.sequence?.camera)?;
        camera.scaled_to(size).ok()
    }

    fn methods(&self) -> impl Iterator<Item = &MethodStudy> {
        self.study.methods.iter()
    }
}

/// The colour of an ink; the truth is light, since the viewer is dark.
pub(super) fn rgb(ink: Ink) -> Color {
    let [r, g, b] = if ink == Ink::Truth { [230; 3] } else { ink.rgb() };
    Color::from_rgb(r, g, b)
}

/// One tab per sequence, played by frames.
pub(super) fn blueprint(scenes: &[Scene<'_>]) -> Blueprint {
    let fps = scenes.iter().find_map(|scene| scene.sequence?.fps);
    let time = TimePanel::new().with_timeline("frame");
    Blueprint::new(Tabs::new(scenes.iter().map(tab)))
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(match fps {
            Some(fps) => time.with_fps(fps),
            None => time,
        })
}

/// Space at the left; pictures and series at the right.
fn tab(scene: &Scene<'_>) -> ContainerLike {
    let mut right: Vec<ContainerLike> = vec![Grid::new(pictures(scene)).with_grid_columns(2).into()];
    let mut shares = vec![3.0_f32];
    let each = |place: &dyn Fn(&MethodStudy) -> EntityPath| -> Vec<String> {
        scene.methods().map(|method| format!("+ {}", place(method))).collect()
    };
    if scene.methods().any(|method| method.motion.is_some()) {
        right.push(
            TimeSeriesView::new("error of position, mm").with_contents(each(&|method| scene.error(method))).into(),
        );
        shares.push(1.0);
    }
    if scene.methods().any(|method| method.run.as_ref().is_some_and(|run| !run.frames.is_empty())) {
        right.push(TimeSeriesView::new("confidence").with_contents(each(&|method| scene.confidence(method))).into());
        right.push(TextLogView::new("warnings").with_origin(scene.root()).into());
        shares.extend([1.0, 1.0]);
    }
    let right = Vertical::new(right).with_row_shares(shares);
    Horizontal::new([space(scene), right.into()])
        .with_name(scene.study.name.as_str())
        .with_column_shares([3.0_f32, 2.0])
        .into()
}

/// Everything but the maps, which the points stand for: the viewer would spread them out without the lens.
fn space(scene: &Scene<'_>) -> ContainerLike {
    let mut contents = vec![format!("+ {}/**", scene.root())];
    for method in scene.methods() {
        let camera = scene.method(method).join(&"camera".into());
        contents.extend(["depth", "reliability"].map(|map| format!("- {camera}/{map}/**")));
    }
    Spatial3DView::new("space").with_origin(scene.root()).with_contents(contents).into()
}

/// The picture, and the maps of every method.
fn pictures(scene: &Scene<'_>) -> Vec<ContainerLike> {
    let view =
        |name: String, place: EntityPath| -> ContainerLike { Spatial2DView::new(name).with_origin(place).into() };
    let mut views = Vec::new();
    for (index, method) in scene.methods().enumerate() {
        let camera = scene.method(method).join(&"camera".into());
        if index == 0 && scene.sequence.is_some() {
            views.push(view("picture".to_owned(), camera.join(&"picture".into())));
        }
        let Some(run) = &method.run else { continue };
        for (name, maps) in [("depth", &run.depth), ("reliability", &run.reliability)] {
            if !maps.is_empty() {
                views.push(view(format!("{name}, {}", method.name), camera.join(&name.into())));
            }
        }
    }
    views
}
