//! Camera models of Calibu (<https://github.com/arpg/calibu>), which EndoMapper's calibrations are written with.

use super::Calibration;
use crate::malformed::{Malformed, finite};
use endoscape_core::camera::{Intrinsics, KannalaBrandt, Pinhole, RadialTangential};
use endoscape_core::{CameraModel, Size};
use roxmltree::Node;

/// Reads one `<camera_model type="calibu_...">`.
pub fn calibration(model: Node<'_, '_>) -> Result<Calibration, Malformed> {
    let kind = model.attribute("type").unwrap_or("");
    let parameters = numbers(model, "params")?;
    let camera = match (kind, parameters.as_slice()) {
        ("calibu_fu_fv_u0_v0", &[fx, fy, cx, cy]) => Pinhole { intrinsics: affine(fx, fy, cx, cy) }.into(),
        ("calibu_fu_fv_u0_v0_k1_k2", &[fx, fy, cx, cy, k1, k2]) => radial(affine(fx, fy, cx, cy), [k1, k2, 0.0]),
        ("calibu_fu_fv_u0_v0_k1_k2_k3", &[fx, fy, cx, cy, k1, k2, k3]) => radial(affine(fx, fy, cx, cy), [k1, k2, k3]),
        ("calibu_fu_fv_u0_v0_kb4", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
            KannalaBrandt { intrinsics: affine(fx, fy, cx, cy), k1, k2, k3, k4 }.into()
        }
        _ => {
            let shown: String = kind.chars().take(40).collect();
            let reason = format!(
                "holds the camera model `{shown}` with {} parameters, which is not supported",
                parameters.len()
            );
            return Err(Malformed { line: line(model), reason });
        }
    };
    Ok(Calibration { size: size(model)?, model: camera })
}

const fn affine(fx: f64, fy: f64, cx: f64, cy: f64) -> Intrinsics {
    Intrinsics { fx, fy, cx, cy, skew: 0.0 }
}

fn radial(intrinsics: Intrinsics, [k1, k2, k3]: [f64; 3]) -> CameraModel {
    RadialTangential::from_opencv(intrinsics, &[k1, k2, 0.0, 0.0, k3]).into()
}

fn size(model: Node<'_, '_>) -> Result<Option<Size>, Malformed> {
    let extent = |name: &str| -> Result<Option<usize>, Malformed> {
        let Some(text) = child(model, name).and_then(|node| node.text()) else { return Ok(None) };
        let value = text.trim().parse().ok().filter(|value| (1..=65_535).contains(value));
        value
            .map(Some)
            .ok_or_else(|| Malformed { line: line(model), reason: format!("states no usable picture {name}") })
    };
    Ok(extent("width")?.zip(extent("height")?).map(|(width, height)| Size::new(width, height)))
}

/// The numbers of a child such as `[ 717.2; 717.4; 735.3 ]`.
fn numbers(model: Node<'_, '_>, name: &str) -> Result<Vec<f64>, Malformed> {
    let text = child(model, name).and_then(|node| node.text()).unwrap_or("");
    let fields = text.split(|c: char| c.is_whitespace() || "[];,".contains(c)).filter(|field| !field.is_empty());
    fields.map(|field| finite(field, name).map_err(|reason| Malformed { line: line(model), reason })).collect()
}

fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn line(node: Node<'_, '_>) -> Option<usize> {
    Some(node.document().text_pos_at(node.range().start).row as usize)
}
