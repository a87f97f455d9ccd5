//! The page and its files as a reader gets them.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail as tests do")]

mod common;

use common::{two_runs, write_run};
use endoscape_eval::trajectory::Settings;
use endoscape_report::{Study, judge, run_report, write_comparison};
use std::path::Path;

/// Five megabytes: what a mail server lets pass.
const LARGEST: usize = 5_000_000;

fn study(folder: &Path, names: [&str; 2]) -> Study {
    judge("Two made-up runs".to_owned(), vec![two_runs(folder, names)], &Settings::default()).unwrap()
}

/// No parse error, and every figure, table and heading a reader without eyes needs.
fn assert_accessible(html: &str) -> scraper::Html {
    let page = scraper::Html::parse_document(html);
    assert!(page.errors.is_empty(), "{:?}", page.errors);
    let all = |selector: &str| page.select(&scraper::Selector::parse(selector).unwrap()).count();
    assert_eq!((all("main"), all("h1"), all("html[lang]"), all("title")), (1, 1, 1, 1));
    assert_eq!(all("figure"), all("figure[aria-labelledby] > figcaption[id]"));
    assert_eq!(all("table"), all("table > caption"));
    assert_eq!(all("thead th"), all("thead th[scope=col]"));
    assert_eq!(all("tbody th"), all("tbody th[scope=row]"));
    assert_eq!(all("svg"), all("svg[role=img][aria-label]") + all("svg[aria-hidden]"));
    page
}

/// Nothing is fetched: the only addresses are data, anchors and the name of the SVG language.
fn assert_self_contained(html: &str) {
    let without_names = html.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    for address in ["http:", "https:", "src=", "url(", "@import", "<script", "<link"] {
        assert!(!without_names.contains(address), "{address}");
    }
    assert!(html.len() < LARGEST, "{}", html.len());
}

#[test]
fn a_comparison_of_runs_has_every_figure_and_stands_alone() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let page = write_comparison(&study(folder.path(), ["ours", "theirs"]), &out).unwrap();
    let html = std::fs::read_to_string(page).unwrap();
    assert_self_contained(&html);
    let parsed = assert_accessible(&html);
    let figures =
        ["paths", "drift-by-length", "error-along-time", "confidence-along-time", "depth", "reliability", "latency"];
    for id in figures {
        let selector = scraper::Selector::parse(&format!("figure#{id}")).unwrap();
        assert_eq!(parsed.select(&selector).count(), 1, "{id}");
        let svg = std::fs::read_to_string(out.join(format!("figures/{id}.svg"))).unwrap();
        roxmltree::Document::parse(&svg).unwrap_or_else(|error| panic!("{id}: {error}"));
        let png = image::open(out.join(format!("figures/{id}.png"))).unwrap().to_rgb8();
        assert!(png.width() > 600 && png.pixels().any(|pixel| pixel.0 != [255; 3]), "{id}");
        let csv = std::fs::read_to_string(out.join(format!("figures/{id}.csv"))).unwrap();
        let mut rows = csv::Reader::from_reader(csv.as_bytes());
        let methods: Vec<String> = rows.records().map(|row| row.unwrap()[0].to_owned()).collect();
        assert!(
            methods.iter().any(|method| method == "ours") && methods.iter().any(|method| method == "theirs"),
            "{id}"
        );
    }
}

#[test]
fn the_json_holds_what_the_page_says() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), ["ours", "theirs"]);
    write_comparison(&study, folder.path()).unwrap();
    let json = std::fs::read_to_string(folder.path().join("compare.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let methods = json["sequences"][0]["methods"].as_array().unwrap();
    let rmse = |index: usize| methods[index]["trajectory"]["ate_m"]["rmse"].as_f64().unwrap();
    assert!(rmse(0) < rmse(1) && rmse(0) > 0.0);
    assert!(methods[0]["depth"]["abs_rel"].as_f64().unwrap() < methods[1]["depth"]["abs_rel"].as_f64().unwrap());
    assert!(methods[0]["trajectory"]["baselines"]["zero"]["ate_m"]["rmse"].as_f64().unwrap() > rmse(0));
    assert_eq!((methods[0]["frames"].as_u64(), methods[0]["tracked"].as_u64()), (Some(12), Some(11)));
    assert_eq!((json["wins"]["best"].as_u64(), json["wins"]["wins"][0].as_u64()), (Some(0), Some(1)));
    assert_eq!(json["sequences"][0]["differences"][0]["other"].as_u64(), Some(1));
    let verdict = json["sequences"][0]["verdict"].to_string();
    assert!(verdict.contains("ours beats every trivial answer on the 91.7 % of the path it answered"), "{verdict}");
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), ["ours", "theirs"]);
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let names = ["report.html", "compare.json", "figures/paths.svg", "figures/paths.png", "figures/depth.png"];
    write_comparison(&study, folder.path()).unwrap();
    let first: Vec<Vec<u8>> = names.iter().map(|name| read(name)).collect();
    write_comparison(&study, folder.path()).unwrap();
    assert!(first == names.iter().map(|name| read(name)).collect::<Vec<_>>());
}

#[test]
fn names_are_escaped_everywhere() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path(), ["<script>alert(1)</script>", "a\"b' & \u{1} c, d"]);
    let page = write_comparison(&study, folder.path()).unwrap();
    let html = std::fs::read_to_string(page).unwrap();
    assert!(!html.contains("<script") && html.contains("&lt;script&gt;alert(1)"));
    assert_accessible(&html.replace('\u{1}', ""));
    let svg = std::fs::read_to_string(folder.path().join("figures/paths.svg")).unwrap();
    let document = roxmltree::Document::parse(&svg).unwrap();
    assert!(document.descendants().any(|node| node.text() == Some("<script>alert(1)</script>")));
    let csv = std::fs::read_to_string(folder.path().join("figures/latency.csv")).unwrap();
    let mut rows = csv::Reader::from_reader(csv.as_bytes());
    assert!(rows.records().any(|row| &row.unwrap()[0] == "a\"b' & \u{1} c, d"));
}

#[test]
fn a_run_alone_is_reported_with_what_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let run = write_run(&folder.path().join("run"), 0.1);
    let html = std::fs::read_to_string(run_report(&run, None).unwrap()).unwrap();
    assert_accessible(&html);
    assert_self_contained(&html);
    assert!(html.contains("The true path is not known") && html.contains("no true depth is known"));
    // Pictures are letters too, and may spell anything.
    let words: String = scraper::Html::parse_document(&html).root_element().text().collect();
    assert!(!words.contains("NaN") && !words.contains("ATE rmse"));
    let html = std::fs::read_to_string(run_report(&run, Some(&common::tube())).unwrap()).unwrap();
    assert_accessible(&html);
    assert!(html.contains("made up on tube") && html.contains("ATE rmse") && html.contains("AbsRel"));
}

#[test]
fn a_run_that_lost_every_frame_still_has_a_report() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("trajectory.tum"), "").unwrap();
    let lines = "index,time_s,tracked,confidence,latency_ms,warning\n0,0,false,0,5,dark\n1,0.1,false,0,6,dark\n";
    std::fs::write(folder.path().join("frames.csv"), lines).unwrap();
    let html = std::fs::read_to_string(run_report(folder.path(), Some(&common::tube())).unwrap()).unwrap();
    assert_accessible(&html);
    assert!(!html.contains("NaN"));
}

#[test]
fn a_path_that_leaves_the_alignment_open_is_shown_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let line: String = (0..12).map(|i| format!("{} {i} 0 0 0 0 0 1\n", f64::from(i) * 0.1)).collect();
    std::fs::write(folder.path().join("trajectory.tum"), line).unwrap();
    let html = std::fs::read_to_string(run_report(folder.path(), Some(&common::tube())).unwrap()).unwrap();
    assert!(html.contains("the path is not judged: the positions lie on one line"));
}

#[test]
fn depth_that_does_not_fit_is_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let run = write_run(&folder.path().join("run"), 0.1);
    let square = endoscape_core::Grid::filled(endoscape_core::Size::new(64, 64), 1_u16);
    endoscape_frames::picture::write_gray16_png(&run.join("depth/000003.png"), &square).unwrap();
    let error = run_report(&run, Some(&common::tube())).unwrap_err().to_string();
    assert!(error.contains("000003.png") && error.contains("64x64") && !error.contains('\n'), "{error}");
    std::fs::write(run.join("depth/000003.png"), "no picture").unwrap();
    let error = run_report(&run, Some(&common::tube())).unwrap_err().to_string();
    assert!(error.contains("000003.png: cannot be read as a map"), "{error}");
}
