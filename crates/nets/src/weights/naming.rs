//! From the path of a tensor in our modules to its name in the PyTorch port of SfMLearner.
//!
//! | ours | port |
//! |---|---|
//! | `encoder.0.halve.conv.weight`, `encoder.0.refine.conv.weight` | `conv1.0.weight`, `conv1.2.weight` |
//! | `decoder.0.up.conv.weight`, `decoder.0.fuse.conv.weight` | `upconv7.0.weight`, `iconv7.0.weight` |
//! | `heads.0.weight` | `predict_disp4.0.weight` |
//! | `encoder.0.conv.weight`, `motion.0.conv.weight` | `conv1.0.weight`, `conv6.0.weight` |
//! | `motion_head.weight` | `pose_pred.weight` |
//! | `mask.ups.0.conv.weight`, `mask.heads.0.weight` | `upconv5.0.weight`, `predict_mask4.weight` |
//!
//! The port has no batch normalisation; ours is named after its convolution, with PyTorch's names for its tensors:
//! `conv1.0.norm.weight`, `.bias`, `.running_mean`, `.running_var`.

/// Name of a tensor of [`DispNet`](crate::DispNet) in the port.
pub(crate) fn disp_net(path: &str) -> String {
    let parts: Vec<&str> = path.split('.').collect();
    match parts.as_slice() {
        ["encoder", stage, "halve", rest @ ..] => format!("conv{}.0.{}", 1 + index(stage), tensor(rest)),
        ["encoder", stage, "refine", rest @ ..] => format!("conv{}.2.{}", 1 + index(stage), tensor(rest)),
        ["decoder", stage, "up", rest @ ..] => format!("upconv{}.0.{}", 7 - index(stage), tensor(rest)),
        ["decoder", stage, "fuse", rest @ ..] => format!("iconv{}.0.{}", 7 - index(stage), tensor(rest)),
        ["heads", head, rest @ ..] => format!("predict_disp{}.0.{}", 4 - index(head), tensor(rest)),
        _ => path.to_string(),
    }
}

/// Name of a tensor of [`PoseMaskNet`](crate::PoseMaskNet) in the port.
pub(crate) fn pose_mask_net(path: &str) -> String {
    let parts: Vec<&str> = path.split('.').collect();
    match parts.as_slice() {
        ["encoder", stage, rest @ ..] => format!("conv{}.0.{}", 1 + index(stage), tensor(rest)),
        ["motion", stage, rest @ ..] => format!("conv{}.0.{}", 6 + index(stage), tensor(rest)),
        ["motion_head", rest @ ..] => format!("pose_pred.{}", tensor(rest)),
        ["mask", "ups", stage, rest @ ..] => format!("upconv{}.0.{}", 5 - index(stage), tensor(rest)),
        ["mask", "heads", head, rest @ ..] => format!("predict_mask{}.{}", 4 - index(head), tensor(rest)),
        _ => path.to_string(),
    }
}

/// Position in one of our arrays, all of which are shorter than eight.
fn index(part: &str) -> usize {
    part.parse::<usize>().map_or(0, |index| index.min(7))
}

fn tensor(rest: &[&str]) -> String {
    match rest {
        ["conv", tensor] => (*tensor).to_string(),
        ["norm", "gamma"] => "norm.weight".to_string(),
        ["norm", "beta"] => "norm.bias".to_string(),
        _ => rest.join("."),
    }
}
