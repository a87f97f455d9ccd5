//! The result in words, first of all whether looking at the pictures was worth it.

use crate::study::{MethodStudy, MotionStudy, SequenceStudy, Study};
use crate::wins::{self, Wins};
use endoscape_eval::trajectory::TrajectoryErrors;

/// Sentences on one sequence.
pub fn of(sequence: &SequenceStudy) -> Vec<String> {
    let mut sentences: Vec<String> = sequence
        .methods
        .iter()
        .filter_map(|method| {
            let motion = method.motion.as_ref()?;
            Some(against_trivial(&method.name, motion))
        })
        .collect();
    if sequence.is_simulated {
        let said =
            "is simulated: pictures, poses and depth come from a program, and no number here speaks about a patient";
        sentences.insert(0, format!("{} {said}.", sequence.name));
    }
    if !sequence.has_truth {
        sentences.push("The true path is not known: nothing here says how right the result is.".to_owned());
    }
    sentences.extend(sequence.methods.iter().filter_map(depth));
    sentences.extend(wins::differences(sequence).iter().map(|difference| {
        let [best, other] = [difference.best, difference.other].map(|index| &sequence.methods[index].name);
        if difference.is_decided() {
            format!("{best} has smaller errors of position than {other}, beyond chance.")
        } else {
            format!("{best} has a smaller error than {other}, but the difference could be chance: its 95 % interval reaches zero.")
        }
    }));
    sentences
}

/// Whether a method beats answers that look at no picture, by absolute error and by drift.
fn against_trivial(name: &str, motion: &MotionStudy) -> String {
    let (errors, baselines) = (&motion.evaluation.errors, &motion.evaluation.baselines);
    let trivial = [
        ("standing still", &baselines.zero),
        ("constant motion", &baselines.constant),
        ("repeating the motion before", &baselines.previous),
    ];
    let (beaten, unbeaten): (Vec<_>, Vec<_>) = trivial.into_iter().partition(|(_, other)| beats(errors, other));
    let names = |list: &[(&str, &TrajectoryErrors)]| join(&list.iter().map(|(name, _)| *name).collect::<Vec<_>>());
    let complete = motion.evaluation.completeness;
    let part = if complete < 0.99 {
        format!(" on the {:.1} % of the path it answered", 100.0 * complete)
    } else {
        String::new()
    };
    if unbeaten.is_empty() {
        let nearest = baselines.zero.ate_m.rmse.min(baselines.constant.ate_m.rmse).min(baselines.previous.ate_m.rmse);
        let times = nearest / errors.ate_m.rmse;
        let times = if times.is_finite() && times < 1e4 { format!("{times:.1} times") } else { "far".to_owned() };
        return format!(
            "{name} beats every trivial answer{part}: its absolute error is {times} below the best of them."
        );
    }
    if beaten.is_empty() {
        return format!(
            "{name} beats no trivial answer{part}: {} do as well or better without looking.",
            names(&unbeaten)
        );
    }
    format!("{name} beats {}{part}, but not {}.", names(&beaten), names(&unbeaten))
}

/// Lower absolute error and, where it is known, lower drift over sub-trajectories.
fn beats(errors: &TrajectoryErrors, other: &TrajectoryErrors) -> bool {
    let drift = |errors: &TrajectoryErrors| errors.segments_mean.map(|mean| mean.translation_percent);
    let drifts_less = drift(errors).zip(drift(other)).is_none_or(|(ours, theirs)| ours < theirs);
    errors.ate_m.rmse < other.ate_m.rmse && drifts_less
}

fn depth(method: &MethodStudy) -> Option<String> {
    let evaluation = method.depth.as_ref()?.evaluation.as_ref()?;
    let (ours, constant) = (evaluation.errors.abs_rel, evaluation.baselines.constant.abs_rel);
    let name = &method.name;
    Some(if ours < constant {
        format!("The depth of {name} beats one depth everywhere: AbsRel {ours:.3} against {constant:.3}.")
    } else {
        format!("The depth of {name} is no better than one depth everywhere: AbsRel {ours:.3} against {constant:.3}.")
    })
}

/// Sentences on all sequences together.
pub fn overall(study: &Study, wins: &Wins) -> Vec<String> {
    let sequences = study.sequences.len();
    let (Some(best), true) = (wins.best, sequences > 1) else { return Vec::new() };
    let name = |index: usize| study.sequences.iter().find_map(|sequence| Some(&sequence.methods.get(index)?.name));
    let mut sentences = Vec::new();
    if let Some(name) = name(best) {
        sentences
            .push(format!("{name} has the lowest absolute error on {} of {sequences} sequences.", wins.wins[best]));
    }
    for (index, test) in wins.tests.iter().enumerate() {
        let (Some(test), Some(best), Some(other)) = (test, name(best), name(index)) else { continue };
        let (pairs, p) = (test.pairs, test.p_value);
        sentences.push(if p < 0.05 {
            format!("{best} is better than {other} beyond chance (signed-rank test over {pairs} sequences, p = {p:.3}).")
        } else if test.smallest_p_value >= 0.05 {
            format!("{pairs} sequences are too few to tell {best} from {other}: no outcome of the signed-rank test could fall below 0.05.")
        } else {
            format!("Whether {best} is better than {other} stays open (signed-rank test over {pairs} sequences, p = {p:.3}).")
        });
    }
    sentences
}

fn join(words: &[&str]) -> String {
    match words {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [front @ .., last] => format!("{} and {last}", front.join(", ")),
    }
}
