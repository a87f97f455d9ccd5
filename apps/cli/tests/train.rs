//! Training as a user runs it: killed, resumed, and refused.

#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stderr,
    reason = "test helpers fail by panicking and say what they skip"
)]

mod common;
use common::{TINY, fail, succeed, tube};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("tiny.toml"), TINY).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The arguments of a new run into `out`.
    fn begin(&self, out: &str, steps: &str) -> Vec<String> {
        let (out, config) = (self.path(out), self.path("tiny.toml"));
        let text = |path: &Path| path.display().to_string();
        let words = ["train", "--data", &tube(), "--out", &text(&out), "--config", &text(&config), "--steps", steps];
        words.map(str::to_owned).to_vec()
    }

    fn resume(&self, out: &str, steps: &str) -> Vec<String> {
        let out = self.path(out).display().to_string();
        ["train", "--data", &tube(), "--out", &out, "--resume", "--steps", steps].map(str::to_owned).to_vec()
    }
}

fn strs(words: &[String]) -> Vec<&str> {
    words.iter().map(String::as_str).collect()
}

/// Waits until the run has logged some steps.
fn wait_for_steps(child: &mut Child, metrics: &Path, lines: usize) {
    let begun = Instant::now();
    while fs::read_to_string(metrics).unwrap_or_default().lines().count() < lines {
        assert!(begun.elapsed() < Duration::from_secs(300), "no step was taken");
        assert!(child.try_wait().unwrap().is_none(), "the training ended by itself");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_killed_training_goes_on_as_if_nothing_had_happened() {
    let place = Place::new();
    succeed(&strs(&place.begin("whole", "12")));

    let binary = env!("CARGO_BIN_EXE_endoscape");
    let mut child = Command::new(binary).args(place.begin("killed", "100000")).stderr(Stdio::null()).spawn().unwrap();
    wait_for_steps(&mut child, &place.path("killed/metrics.csv"), 4);
    // SIGKILL on Unix: no handler runs.
    child.kill().unwrap();
    child.wait().unwrap();
    succeed(&strs(&place.resume("killed", "12")));

    let weights = |run: &str| fs::read(place.path(run).join("latest/weights.safetensors")).unwrap();
    assert!(weights("whole") == weights("killed"), "the weights differ");
}

#[test]
fn what_a_run_found_out_is_learned_too() {
    let place = Place::new();
    let path = |name: &str| place.path(name).display().to_string();
    succeed(&strs(&place.begin("first", "4")));
    succeed(&["run", &tube(), "--model", &path("first"), "--out", &path("found")]);
    let with_labels = |out: &str, runs: &[&str]| {
        let init = ["--init".to_owned(), path("first"), "--labels".to_owned()];
        [place.begin(out, "6"), init.into(), runs.iter().map(|run| path(run)).collect()].concat()
    };
    succeed(&strs(&with_labels("second", &["found"])));
    let table = fs::read_to_string(place.path("second/metrics.csv")).unwrap();
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let columns = lines.next().unwrap();
    let rows: Vec<_> = lines.collect();
    for name in ["label_depth", "label_motion"] {
        let column = columns.iter().position(|column| *column == name).unwrap();
        let figures: Vec<f64> = rows.iter().map(|row| row[column].parse().unwrap()).collect();
        assert!(figures.len() == 6 && figures.iter().all(|figure| *figure > 0.0), "{name}: {figures:?}");
    }

    // A stage of its own makes an alignment network, which takes part at work.
    fs::write(path("alignment.toml"), format!("{TINY}\n[lesson]\nalignment = true\n")).unwrap();
    let stage = with_labels("aligned", &["found"]).into_iter().map(|word| word.replace("tiny.toml", "alignment.toml"));
    succeed(&strs(&stage.collect::<Vec<_>>()));
    let manifest = |run: &str| fs::read_to_string(place.path(run).join("latest/manifest.json")).unwrap();
    assert!(manifest("aligned").contains("\"align\"") && !manifest("second").contains("\"align\""));
    succeed(&["run", &tube(), "--model", &path("aligned"), "--networks-only", "--out", &path("again")]);
    assert!(fs::read_to_string(place.path("again/frames.csv")).unwrap().lines().count() > 2);

    let sentence = fail(&strs(&with_labels("third", &["found", "found"])));
    assert!(sentence.contains("--labels names 2 runs but --data 1 inputs"), "{sentence}");
    let sentence = fail(&strs(&with_labels("third", &["first"])));
    assert!(sentence.contains("run"), "{sentence}");
    assert!(!place.path("third").exists(), "something was left behind");
    let sentence = fail(&strs(&place.resume("second", "8")));
    assert!(sentence.contains("give the same --labels as before"), "{sentence}");
}

#[test]
fn every_preset_learns() {
    for preset in ["paper", "fast", "endo"] {
        let place = Place::new();
        let words = [place.begin("run", "4"), ["--preset", preset].map(str::to_owned).to_vec()].concat();
        succeed(&strs(&words));
        let table = fs::read_to_string(place.path("run/metrics.csv")).unwrap();
        let losses: Vec<f64> =
            table.lines().skip(1).map(|line| line.split(',').nth(4).unwrap().parse().unwrap()).collect();
        assert!(losses.len() == 4 && losses.iter().all(|loss| loss.is_finite()), "{preset}: {table}");
        assert!(losses.windows(2).all(|pair| pair[0] != pair[1]), "{preset}: {table}");
    }
}

#[test]
fn slips_are_told_before_anything_is_written() {
    let place = Place::new();
    let with = |change: &dyn Fn(&mut Vec<String>)| {
        let mut words = place.begin("run", "1");
        change(&mut words);
        fail(&strs(&words))
    };
    let sentence = with(&|words| words[2] = place.path("nothing").display().to_string());
    assert!(sentence.contains("no such file"), "{sentence}");
    let sentence = with(&|words| words.extend(["--size".into(), "8x8".into()]));
    assert!(sentence.contains("`width` is 8"), "{sentence}");
    let sentence = with(&|words| words[2] = format!("{}@900..901", tube()));
    assert!(sentence.contains("the range is empty"), "{sentence}");
    let sentence = with(&|words| words.extend(["--init".into(), place.path("none").display().to_string()]));
    assert!(sentence.contains("no such checkpoint"), "{sentence}");
    let sentence = with(&|words| words.extend(["--device".into(), "cuda:97".into()]));
    assert!(sentence.contains("cannot compute on cuda:97") || sentence.contains("does not answer"), "{sentence}");
    let sentence = fail(&strs(&place.resume("run", "2")));
    assert!(sentence.contains("no training run to resume"), "{sentence}");
    assert!(!place.path("run").exists(), "something was left behind");
}

/// Starts a run with one slip and returns the sentence; no folder may be left behind.
fn refused(place: &Place, change: impl Fn(&mut Vec<String>)) -> String {
    let mut words = place.begin("run", "1");
    change(&mut words);
    let sentence = fail(&strs(&words));
    assert!(!place.path("run").exists(), "something was left behind: {sentence}");
    sentence
}

#[test]
fn weights_that_are_damaged_or_of_another_network() {
    let place = Place::new();
    succeed(&strs(&place.begin("first", "1")));
    fs::write(place.path("tiny.toml"), TINY.replace("[4, 4, 8, 8, 8, 8, 8]", "[6, 4, 8, 8, 8, 8, 8]")).unwrap();
    succeed(&strs(&place.begin("second", "1")));
    let (weights, config) = (place.path("first/best/weights.safetensors"), place.path("first/best/config.toml"));
    let init = |words: &mut Vec<String>| words.extend(["--init".into(), place.path("first").display().to_string()]);

    let whole = fs::read(&weights).unwrap();
    fs::write(&weights, &whole[..whole.len() / 2]).unwrap();
    let sentence = refused(&place, init);
    assert!(sentence.contains("weights.safetensors"), "{sentence}");
    fs::write(&weights, &whole).unwrap();

    fs::copy(place.path("second/best/config.toml"), &config).unwrap();
    let sentence = refused(&place, init);
    assert!(sentence.contains("weights.safetensors") && sentence.contains("conv1.0.weight"), "{sentence}");
    assert_eq!(fs::read(&weights).unwrap(), whole, "the checkpoint was touched");
}

#[test]
fn data_that_nothing_can_be_learned_from() {
    let place = Place::new();
    let sentence = refused(&place, |words| words[2] = format!("{}@3..4", tube()));
    assert!(sentence.contains("gives no snippet of 3 frames"), "{sentence}");

    let (mixed, small) = (place.path("mixed"), endoscape_core::Size::new(8, 8));
    common::copy(tube(), &mixed);
    let picture = endoscape_core::Image::from_fn(small, |_, _| [1; 3]);
    endoscape_frames::picture::write_png(&mixed.join("frames/000003.png"), &picture).unwrap();
    let sentence = refused(&place, |words| words[2] = mixed.display().to_string());
    assert!(sentence.contains("000003.png") && sentence.contains("8x8"), "{sentence}");

    let (frames, camera) = (place.path("mixed/frames"), place.path("lens.yaml"));
    fs::copy(Path::new(&tube()).join("frames/000003.png"), frames.join("000003.png")).unwrap();
    fs::write(&camera, "this is no calibration").unwrap();
    let sentence = refused(&place, |words| {
        words[2] = frames.display().to_string();
        words.extend(["--camera".into(), camera.display().to_string()]);
    });
    assert!(sentence.contains("lens.yaml"), "{sentence}");
}

#[test]
fn pictures_that_are_no_numbers() {
    let place = Place::new();
    let frames = place.path("float");
    fs::create_dir(&frames).unwrap();
    for number in 0..4 {
        let pixel = |x: u32, _| image::Rgb([if x == 5 { f32::NAN } else { 0.4 }, 0.2, 0.3]);
        let picture = image::DynamicImage::ImageRgb32F(image::ImageBuffer::from_fn(64, 48, pixel));
        picture.save(frames.join(format!("{number}.tiff"))).unwrap();
    }
    let sentence = refused(&place, |words| {
        words[2] = frames.display().to_string();
        words.extend(["--hfov".into(), "80".into()]);
    });
    assert!(sentence.contains("0.tiff") && sentence.contains("not a number"), "{sentence}");
}

/// A disk of four megabytes of its own fills up in the middle of a run; room made, the run goes on.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_costs_no_checkpoint() {
    let place = Place::new();
    let disk = place.path("disk");
    fs::create_dir(&disk).unwrap();
    let command = |words: Vec<String>| format!("{} {}", env!("CARGO_BIN_EXE_endoscape"), words.join(" "));
    let (begin, resume) = (command(place.begin("disk/run", "2")), command(place.resume("disk/run", "4")));
    let disk = disk.display();
    let script = format!(
        "mount -t tmpfs -o size=4m none {disk} || exit 99
        {begin} && ! dd if=/dev/zero of={disk}/filler bs=4k 2>&- && ! {resume} && rm {disk}/filler && {resume}"
    );
    // Mounting needs a name space of our own.
    let output = Command::new("unshare").args(["--map-root-user", "--mount", "sh", "-c", &script]).output();
    let Some(output) = output.ok().filter(|output| output.status.code() != Some(99)) else {
        eprintln!("skipped: a small disk cannot be mounted here");
        return;
    };
    let told = String::from_utf8_lossy(&output.stderr);
    if told.contains("unshare") {
        eprintln!("skipped: {told}");
        return;
    }
    assert!(output.status.success(), "{told}");
    let errors: Vec<&str> = told.lines().filter(|line| line.starts_with("error: ")).collect();
    assert!(errors.len() == 1 && errors[0].contains("No space left"), "{told}");
}
