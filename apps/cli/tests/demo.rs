//! `endoscape demo`, driven as a newcomer drives it.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "helpers of tests fail and speak as tests do"
)]

mod common;

use common::{Folder, fail, succeed};

#[test]
fn the_demo_needs_nothing_and_ends_with_one_page() {
    let folder = Folder::new();
    let out = folder.path("demo");
    let said = succeed(&["demo", "--frames", "12", "--out", &out]);
    for step in ["$ endoscape simulate", "$ endoscape run", "$ endoscape compare"] {
        assert!(said.contains(step), "{said}");
    }
    let page = std::fs::read_to_string(folder.path("demo/report.html")).unwrap();
    assert!(page.contains("is simulated"), "the page says so");
    for outside in ["src=\"http", "href=\"http", "url(http", "<script src", "@import"] {
        assert!(!page.contains(outside), "the page asks the network for {outside}");
    }
    let model = folder.path("demo/model");
    let again = folder.path("again");
    succeed(&["run", &folder.path("demo/patient"), "--model", &model, "--out", &again]);
    let poses = |run: &str| std::fs::read(format!("{run}/trajectory.tum")).unwrap();
    assert_eq!(poses(&again), poses(&folder.path("demo/learned")), "typed again, the same comes out");
}

#[test]
fn a_folder_in_use_is_left_alone() {
    let folder = Folder::new();
    let file = folder.file("mine/notes.txt", "keep");
    let sentence = fail(&["demo", "--out", &folder.path("mine")]);
    assert!(sentence.contains("holds files already") && sentence.contains("--out"), "{sentence}");
    assert_eq!(std::fs::read_to_string(file).unwrap(), "keep");
}
