//! `--record`, driven as a user drives it.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests fail and speak as tests do"
)]

mod common;

use common::{Folder, fail, tube};
use std::path::Path;

#[cfg(not(feature = "rerun"))]
#[test]
fn a_build_without_recordings_says_how_to_get_one_and_does_nothing_else() {
    let folder = Folder::new();
    let (file, out) = (folder.path("session.rrd"), folder.path("out"));
    for call in [
        ["run", &tube(), "--method", "direct", "--out", &out, "--record", &file],
        ["compare", &tube(), "--truth", &tube(), "--out", &out, "--record", &file],
    ] {
        let sentence = fail(&call);
        assert!(sentence.contains("session.rrd") && sentence.contains("--features rerun"), "{sentence}");
    }
    assert!(!Path::new(&out).exists() && !Path::new(&file).exists());
}

#[cfg(feature = "rerun")]
mod with_recordings {
    use super::*;
    use common::succeed;
    use re_sdk::external::re_log_encoding::Decoder;
    use re_sdk::log::{Chunk, LogMsg};
    use std::collections::BTreeMap;

    /// Rows by entity, of the recording and not of its layout, and whether there is a layout.
    fn rows(file: &str) -> (BTreeMap<String, usize>, bool) {
        let reader = std::io::BufReader::new(std::fs::File::open(file).unwrap());
        let (mut rows, mut layout) = (BTreeMap::new(), false);
        for message in Decoder::<LogMsg>::decode_lazy(reader) {
            match message.unwrap() {
                LogMsg::ArrowMsg(store, message) if store.is_recording() => {
                    let chunk = Chunk::from_arrow_msg(&message).unwrap();
                    *rows.entry(chunk.entity_path().to_string()).or_default() += chunk.num_rows();
                }
                LogMsg::BlueprintActivationCommand(_) => layout = true,
                _ => {}
            }
        }
        (rows, layout)
    }

    #[test]
    fn a_run_and_a_comparison_are_recorded() {
        let folder = Folder::new();
        let (run, first, second) = (folder.path("run"), folder.path("run.rrd"), folder.path("compared.rrd"));
        let said = succeed(&["run", &tube(), "--method", "direct", "--out", &run, "--record", &first]);
        assert!(said.contains("recording   ") && said.contains("run.rrd"), "{said}");
        let (of_run, layout) = rows(&first);
        assert!(layout);
        for (entity, count) in [("camera", 12), ("camera/picture", 13), ("confidence", 13)] {
            assert_eq!(of_run[&format!("/tube/direct/{entity}")], count, "{entity}: {of_run:?}");
        }
        assert!(of_run["/tube/direct/camera/points"] > 6 && of_run.contains_key("/tube/truth/path"), "{of_run:?}");

        let poses = std::fs::read_to_string(Path::new(&tube()).join("poses.tum")).unwrap();
        let perfect = folder.file("perfect.txt", poses);
        let out = folder.path("out");
        let (truth, runs) = (format!("fixture={}", tube()), format!("ours={run}"));
        succeed(&["compare", "--truth", &truth, &runs, &perfect, "--out", &out, "--record", &second]);
        let (of_both, _) = rows(&second);
        for (entity, count) in [("ours/camera", 12), ("perfect/camera", 12), ("perfect/error_mm", 13)] {
            assert_eq!(of_both[&format!("/fixture/{entity}")], count, "{entity}: {of_both:?}");
        }
        assert!(!of_both.contains_key("/fixture/perfect/camera/depth"));
    }

    #[test]
    fn a_file_that_cannot_be_written_is_told_before_the_work() {
        let folder = Folder::new();
        let out = folder.path("out");
        let file = folder.path("no/such/folder/session.rrd");
        let sentence = fail(&["run", &tube(), "--method", "direct", "--out", &out, "--record", &file]);
        assert!(sentence.contains("session.rrd: cannot be written"), "{sentence}");
        assert!(!Path::new(&out).exists());
    }
}
