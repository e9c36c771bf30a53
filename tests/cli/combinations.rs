//! Pairwise combinations of flags: each run either writes everything it promises, or names what it refuses and writes nothing.
//! Running the same command again changes nothing.

use super::*;
use lsdc_eval::data::{Camera, Contents, Shard, Unit, read_rgb, stored_unit};
use lsdc_rng::Rng;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::process::Output;
use std::sync::Mutex;

const WIDTH: usize = 48;
const HEIGHT: usize = 36;
const CAMERA: &str = "40,40,23.5,17.5";

/// A flag, or a property of the inputs, and its values.
type Factor = (&'static str, &'static [&'static str]);

fn has_ending(name: &str, ending: &str) -> bool {
    Path::new(name).extension().is_some_and(|e| e == ending)
}

/// Index of the value of each factor.
type Row = Vec<usize>;

/// Returns rows that contain every pair of values of two factors. Each new row takes, greedily, the values that cover most of
/// the remaining pairs.
fn pairs(factors: &[Factor]) -> Vec<Row> {
    let mut rng = Rng::stream(0, &["combinations"]);
    let mut left = BTreeSet::new();
    for (b, (_, second)) in factors.iter().enumerate() {
        for (a, (_, first)) in factors[..b].iter().enumerate() {
            for i in 0..first.len() {
                left.extend((0..second.len()).map(|j| (a, i, b, j)));
            }
        }
    }
    let mut rows = Vec::new();
    while let Some(&(a, i, b, j)) = left.iter().next() {
        let mut row = vec![None; factors.len()];
        (row[a], row[b]) = (Some(i), Some(j));
        let mut order: Vec<usize> = (0..factors.len()).filter(|f| row[*f].is_none()).collect();
        let count = order.len();
        rng.choose(&mut order, count);
        for factor in order {
            let covered = |value: usize| {
                let set = row.iter().enumerate().filter_map(|(f, v)| Some((f, (*v)?)));
                set.filter(|&(other, v)| {
                    let pair = if other < factor {
                        (other, v, factor, value)
                    } else {
                        (factor, value, other, v)
                    };
                    left.contains(&pair)
                })
                .count()
            };
            // The random offset breaks ties.
            let values = factors[factor].1.len();
            let offset = rng.below(values as u32) as usize;
            let best = (0..values)
                .map(|value| (value + offset) % values)
                .max_by_key(|&value| covered(value));
            row[factor] = best;
        }
        let row: Row = row.into_iter().flatten().collect();
        left.retain(|&(a, i, b, j)| row[a] != i || row[b] != j);
        rows.push(row);
    }
    rows
}

#[test]
fn every_pair_is_in_a_row() {
    let factors: [Factor; 4] = [
        ("a", &["0", "1", "2"]),
        ("b", &["0", "1"]),
        ("c", &["0", "1", "2", "3"]),
        ("d", &["0", "1"]),
    ];
    let rows = pairs(&factors);
    assert!((12..=16).contains(&rows.len()), "{} rows", rows.len());
    for (a, i, b, j) in [(0, 2, 2, 3), (1, 1, 3, 0), (0, 0, 3, 1)] {
        assert!(rows.iter().any(|row| row[a] == i && row[b] == j));
    }
}

/// Replaces values of a refused row by the first of their factor, starting at the last factor, until the row is accepted:
/// refusal would hide the pairs in the row.
fn accepted(factors: &[Factor], row: &Row, refused: impl Fn(&Choice) -> bool) -> Row {
    let mut row = row.clone();
    for factor in (0..row.len()).rev() {
        if !refused(&Choice(factors, &row)) {
            break;
        }
        row[factor] = 0;
    }
    row
}

/// The value of a factor in a row.
struct Choice<'a>(&'a [Factor], &'a Row);

impl Choice<'_> {
    fn of(&self, name: &str) -> &'static str {
        let place = self.0.iter().position(|(n, _)| *n == name).unwrap();
        self.0[place].1[self.1[place]]
    }

    fn is(&self, name: &str, value: &str) -> bool {
        self.of(name) == value
    }

    fn words(&self) -> String {
        let words = self
            .0
            .iter()
            .map(|(name, _)| format!("{name}={}", self.of(name)));
        words.collect::<Vec<_>>().join(" ")
    }
}

/// Calls `check` for every row, and for the accepted version of each refused row, on two threads; reports all failures at the
/// end.
fn each(
    factors: &[Factor],
    refused: impl Fn(&Choice) -> bool,
    check: impl Fn(&Choice, &Path) -> Result<(), String> + Sync,
) {
    let rows: BTreeSet<Row> = pairs(factors)
        .into_iter()
        .flat_map(|row| [accepted(factors, &row, &refused), row])
        .collect();
    let rows = Mutex::new(rows);
    let failures = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let row = rows.lock().unwrap().pop_first();
                    let Some(row) = row else { break };
                    let choice = Choice(factors, &row);
                    let folder = tempfile::tempdir().unwrap();
                    if let Err(what) = check(&choice, folder.path()) {
                        let text = format!("{}\n    {what}", choice.words());
                        failures.lock().unwrap().push(text);
                    }
                }
            });
        }
    });
    let failures = failures.into_inner().unwrap();
    assert!(
        failures.is_empty(),
        "{} wrong:\n{}",
        failures.len(),
        failures.join("\n")
    );
}

fn ensure(fine: bool, what: impl FnOnce() -> String) -> Result<(), String> {
    if fine { Ok(()) } else { Err(what()) }
}

/// All files below a folder with their contents, except the records.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(below) = folders.pop() {
        for entry in std::fs::read_dir(below).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                if path.file_name().unwrap() != ".lsdc" {
                    folders.push(path);
                }
            } else {
                let name = path.strip_prefix(folder).unwrap();
                let name = name.to_string_lossy().into_owned();
                found.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// Checks that exit code and messages agree.
fn check_words(run: &Output) -> Result<i32, String> {
    let said = String::from_utf8_lossy(&run.stderr);
    let code = run.status.code().unwrap_or(-1);
    let errors = said.lines().filter(|l| l.starts_with("error:")).count();
    let right = match code {
        0 => errors == 0,
        2 => errors == 1,
        3 => errors > 0 && said.contains("failed: "),
        _ => false,
    };
    ensure(right && !said.contains("panicked"), || {
        format!("exit code {code}: {said}")
    })?;
    Ok(code)
}

const COMPLETE: [Factor; 16] = [
    (
        "points",
        &[
            "npy", "png", "csv", "sigma", "npz", "tiff", "exr", "pfm", "ply",
        ],
    ),
    ("images", &["one", "folder", "list", "stdin"]),
    ("output", &["folder", "file", "pipe"]),
    (
        "formats",
        &["usual", "npy", "png", "npz", "exr", "json", "every"],
    ),
    (
        "method",
        &["lse", "field", "joint", "nearest", "linear", "ip-basic"],
    ),
    ("size", &["", "31x23", "96x72"]),
    ("robust", &["none", "huber", "tukey", "auto"]),
    ("preserve", &["none", "exact", "blend"]),
    ("uncertainty", &["", "yes"]),
    ("outliers", &["", "yes"]),
    ("temporal", &["", "yes"]),
    ("shard", &["0/1", "0/2"]),
    ("json", &["", "yes"]),
    ("camera", &["yes", ""]),
    ("full", &["", "yes"]),
    ("factor", &["1", "40"]),
];

const USUAL: [&str; 3] = ["npy", "png", "color"];
const EVERY: [&str; 9] = [
    "npy", "npz", "png", "tiff", "exr", "pfm", "color", "ply", "json",
];

/// The formats that a row requests.
fn formats(row: &Choice) -> Vec<&'static str> {
    match (row.of("formats"), row.of("output")) {
        ("usual", "folder") => USUAL.to_vec(),
        ("usual", _) => vec!["npy"],
        ("every", "file") => vec!["ply"],
        ("every", _) => EVERY.to_vec(),
        (one, _) => vec![one],
    }
}

fn end(format: &str) -> String {
    match format {
        "color" => "depth_color.png".into(),
        "ply" => "cloud.ply".into(),
        "json" => "report.json".into(),
        other => format!("depth.{other}"),
    }
}

/// Word in the message that refuses a row; `None` if the row is accepted.
fn refusal(row: &Choice) -> Option<&'static str> {
    let yes = |name: &str| row.is(name, "yes");
    let several = matches!(row.of("images"), "folder" | "list");
    let classic = matches!(row.of("method"), "nearest" | "linear" | "ip-basic");
    let formats = formats(row);
    let cloud = row.is("points", "ply") || formats.contains(&"ply");
    if row.is("output", "pipe") {
        let room = matches!(formats[..], ["npz" | "exr"]);
        if several || formats.len() > 1 || yes("outliers") || yes("json") {
            return Some("only one file fits");
        }
        if yes("uncertainty") && !room {
            return Some("only one file fits");
        }
    }
    if several && row.is("output", "file") {
        return Some("names no folder");
    }
    if !several && yes("temporal") {
        return Some("would change nothing");
    }
    if several && yes("temporal") && !row.is("shard", "0/1") {
        return Some("cannot be combined");
    }
    let switches = ["uncertainty", "outliers", "temporal", "full"];
    let needs = switches.into_iter().any(yes) || !row.is("size", "") || !row.is("robust", "none");
    if classic && needs {
        return Some("need method `lsdc`");
    }
    if yes("temporal") && row.is("method", "field") {
        return Some("would change nothing");
    }
    if cloud && !yes("camera") && !several {
        return Some("camera");
    }
    None
}

/// Writes points of the image and, if the form allows, two that are not used: a NaN, and one outside the image. Returns the
/// number of points.
fn write_points(form: &str, path: &Path, factor: f32) -> usize {
    let mut rng = Rng::stream(1, &["points"]);
    let mut map = vec![0.0; WIDTH * HEIGHT];
    for place in (7..map.len()).step_by(29) {
        // Whole millimetres, which a PNG stores exactly.
        map[place] = factor * (1.0 + rng.below(600) as f32 / 1000.0);
    }
    let depth = DepthMap::new(WIDTH, HEIGHT, map).unwrap();
    let count = depth.count();
    match form {
        "npy" => write_npy(path, &depth).unwrap(),
        "png" => {
            let unit = lsdc_eval::data::png_unit(&depth).unwrap();
            lsdc_eval::data::write_depth_png(path, &depth, unit.metres()).unwrap();
        }
        "npz" => lsdc_eval::data::write_npz(path, &[("depth", &depth)]).unwrap(),
        "tiff" => lsdc_eval::data::write_tiff(path, &depth).unwrap(),
        "exr" => lsdc_eval::data::write_exr(path, &depth, None).unwrap(),
        "pfm" => lsdc_eval::data::write_pfm(path, &depth).unwrap(),
        "csv" | "sigma" => {
            let mut text = String::from(if form == "csv" {
                "u,v,depth\n"
            } else {
                "u,v,depth,sigma\n"
            });
            let points = depth.points().map(|p| (p.x, p.y, p.depth));
            for (x, y, d) in points.chain([(3, 3, f32::NAN), (900, 3, 2.0)]) {
                let sigma = if form == "csv" { "" } else { ",0.02" };
                writeln!(text, "{x},{y},{d}{sigma}").unwrap();
            }
            std::fs::write(path, text).unwrap();
            return count + 2;
        }
        "ply" => {
            let camera: Camera = CAMERA.parse().unwrap();
            let mut text = format!(
                "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\n\
                 property float z\nend_header\n",
                count + 1
            );
            for p in depth.points() {
                let place = [p.x as f64, p.y as f64];
                let [x, y, z] = camera.unproject(place, f64::from(p.depth)).unwrap();
                writeln!(text, "{x} {y} {z}").unwrap();
            }
            writeln!(text, "900 0 1").unwrap();
            std::fs::write(path, text).unwrap();
            return count + 1;
        }
        other => panic!("{other}"),
    }
    count
}

/// The inputs of a row, its command, and the number of points of each image.
fn command(row: &Choice, at: &Path) -> (Vec<String>, Option<Vec<u8>>, usize) {
    let form = row.of("points");
    let ending = if form == "sigma" { "csv" } else { form };
    let (images, points) = (at.join("images"), at.join("points"));
    for folder in [&images, &points] {
        std::fs::create_dir(folder).unwrap();
    }
    let rgb = image::RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, y| {
        image::Rgb([(x * 5) as u8, (y * 7) as u8, if x > 20 { 200 } else { 40 }])
    });
    let mut count = 0;
    for name in ["a", "b"] {
        rgb.save(images.join(format!("{name}.png"))).unwrap();
        let path = points.join(format!("{name}.{ending}"));
        count = write_points(form, &path, row.of("factor").parse().unwrap());
    }
    let list = format!("a.png ../points/a.{ending}\nb.png ../points/b.{ending}\n");
    std::fs::write(images.join("list.txt"), list).unwrap();
    let one = format!("points/a.{ending}");
    let (image, sparse) = match row.of("images") {
        "one" => ("images/a.png", &*one),
        "stdin" => ("images/a.png", "-"),
        "folder" => ("images", "points"),
        _ => ("images/list.txt", "points"),
    };
    let stdin = (sparse == "-").then(|| std::fs::read(at.join(&one)).unwrap());
    let formats = formats(row);
    let output = match row.of("output") {
        "folder" => "out".to_owned(),
        "pipe" => "-".to_owned(),
        _ => format!(
            "out.{}",
            if formats == ["color"] {
                "png"
            } else {
                formats[0]
            }
        ),
    };
    let mut args = vec![
        "complete",
        image,
        sparse,
        "-o",
        &output,
        "--weights",
        "small",
    ];
    let list = formats.join(",");
    if !row.is("output", "file") && !row.is("formats", "usual") {
        args.extend(["--formats", &list]);
    }
    match row.of("method") {
        fit @ ("lse" | "field" | "joint") => args.extend(["--fit", fit]),
        method => args.extend(["--method", method]),
    }
    for (flag, name) in [
        ("--size", "size"),
        ("--robust", "robust"),
        ("--preserve-input", "preserve"),
        ("--shard", "shard"),
    ] {
        if !row.is(name, "") {
            args.extend([flag, row.of(name)]);
        }
    }
    for flag in [
        "--uncertainty",
        "--outliers",
        "--temporal",
        "--json",
        "--full",
    ] {
        if row.is(&flag[2..], "yes") {
            args.push(flag);
        }
    }
    if row.is("camera", "yes") {
        args.extend(["--camera", CAMERA]);
    }
    (args.into_iter().map(str::to_owned).collect(), stdin, count)
}

fn run(at: &Path, args: &[String], stdin: Option<&Vec<u8>>) -> Output {
    let mut command = lsdc(at);
    command.env("RAYON_NUM_THREADS", "1").args(args);
    if let Some(bytes) = stdin {
        command.write_stdin(bytes.clone());
    }
    command.output().unwrap()
}

/// Files that a row must write, relative to its folder.
fn promised(row: &Choice) -> BTreeSet<String> {
    let several = matches!(row.of("images"), "folder" | "list");
    let shard: Shard = row.of("shard").parse().unwrap();
    let mut stems = vec!["a"];
    if several {
        stems.push("b");
        stems.retain(|name| shard.holds(&format!("{name}.png")));
    }
    let mut extra = Vec::new();
    for (name, file) in [("uncertainty", "sigma.npy"), ("outliers", "outliers.csv")] {
        if row.is(name, "yes") {
            extra.push(file.to_owned());
        }
    }
    let mut files = BTreeSet::new();
    for stem in stems {
        match (row.of("output"), several) {
            ("pipe", _) => {}
            ("file", false) => {
                files.insert(format!("out.{}", formats(row)[0]));
                files.extend(extra.iter().map(|file| format!("out_{file}")));
            }
            _ => {
                let ends = formats(row).into_iter().map(end).chain(extra.clone());
                files.extend(ends.map(|end| format!("out/{stem}_{end}")));
            }
        }
    }
    files
}

/// Reads a written depth map, and its largest rounding error.
fn read_map(path: &Path) -> Option<(DepthMap, f64)> {
    let ending = path.extension()?.to_str()?;
    let map = ["npy", "npz", "png", "tiff", "exr", "pfm"].contains(&ending);
    let name = path.file_name()?.to_str()?;
    if !map || name.contains("color") || name.contains("sigma") {
        return None;
    }
    let found = Contents::read(path, None).unwrap();
    let off = stored_unit(path).map_or(0.0, |unit: Unit| 0.501 * unit.metres());
    Some((found.map()?.clone(), off))
}

fn check_files(row: &Choice, at: &Path, count: usize) -> Result<(), String> {
    let (width, height) = match row.of("size").split_once('x') {
        Some((w, h)) => (w.parse().unwrap(), h.parse().unwrap()),
        None => (WIDTH, HEIGHT),
    };
    let mut first: BTreeMap<String, (DepthMap, f64)> = BTreeMap::new();
    for name in promised(row) {
        let path = at.join(&name);
        let stem = name.split('_').next().unwrap().to_owned();
        if let Some((map, off)) = read_map(&path) {
            ensure((map.width(), map.height()) == (width, height), || {
                format!("{name} is {}x{}", map.width(), map.height())
            })?;
            ensure(map.count() == width * height, || {
                format!("{name} has {} of {} depths", map.count(), width * height)
            })?;
            if let Some((other, other_off)) = first.get(&stem) {
                let mut pairs = map.values().iter().zip(other.values());
                let bound = off + other_off;
                let far = pairs.find(|(a, b)| f64::from((*a - *b).abs()) > bound);
                ensure(far.is_none(), || format!("{name} differs: {far:?}"))?;
            } else {
                first.insert(stem.clone(), (map, off));
            }
        }
        if name.ends_with("color.png") {
            let size = read_rgb(&path).map_err(|e| e.to_string())?.dimensions();
            // The colour scale is below the map.
            let higher = size.1 > height as u32 && size.1 < height as u32 + 40;
            ensure(size.0 == width as u32 && higher, || {
                format!("{name}: {size:?}")
            })?;
        }
        if name.ends_with("sigma.npy") {
            let map = read_npy(&path, 1.0).map_err(|e| e.to_string())?;
            ensure(map.count() == width * height, || {
                format!("{name}: {}", map.count())
            })?;
        }
        if has_ending(&name, "ply") {
            let bytes = std::fs::read(&path).unwrap();
            let text = String::from_utf8_lossy(&bytes[..bytes.len().min(300)]).into_owned();
            let count = text
                .lines()
                .find_map(|line| line.strip_prefix("element vertex "));
            let count = count.and_then(|count| count.parse().ok()).unwrap_or(0);
            // Flying pixels are left out.
            let all = width * height;
            ensure((all / 2..=all).contains(&count), || {
                format!("{name}: {text}")
            })?;
        }
        if name.ends_with("outliers.csv") {
            let text = std::fs::read_to_string(&path).unwrap();
            ensure(text.starts_with("u,v,depth"), || text.clone())?;
        }
        if name.ends_with("report.json") || name == "out.json" {
            check_report(&json(&path), count)?;
        }
    }
    Ok(())
}

/// Checks that the report counts every point as used or left out for a reason.
fn check_report(report: &Value, count: usize) -> Result<(), String> {
    let points = report["points"].as_object().ok_or("no points")?;
    let sum: u64 = points.values().filter_map(Value::as_u64).sum();
    ensure(sum == count as u64, || {
        format!("{sum} of {count} points: {points:?}")
    })?;
    ensure(report["status"] == "completed", || report.to_string())
}

#[test]
fn every_pair_of_flags_of_complete() {
    let done = Mutex::new((0, 0));
    each(
        &COMPLETE,
        |row| refusal(row).is_some(),
        |row, at| {
            let (args, stdin, count) = command(row, at);
            let before = files(at);
            let first = run(at, &args, stdin.as_ref());
            let code = check_words(&first)?;
            let said = String::from_utf8_lossy(&first.stderr);
            let after = files(at);
            if let Some(word) = refusal(row) {
                ensure(code == 2 && said.contains(word), || {
                    format!("not refused for `{word}`: {code} {said}")
                })?;
                ensure(before == after, || "it left files behind".into())?;
                done.lock().unwrap().1 += 1;
                return Ok(());
            }
            let several = matches!(row.of("images"), "folder" | "list");
            let cloud = row.is("points", "ply") || formats(row).contains(&"ply");
            // With several images, each frame fails separately.
            if several && cloud && !row.is("camera", "yes") {
                ensure(code != 0, || "it succeeded".into())?;
                return ensure(before == after, || "it left files behind".into());
            }
            ensure(code == 0, || format!("{code}: {args:?} {said}"))?;
            let new: BTreeSet<String> = after
                .keys()
                .filter(|name| !before.contains_key(*name))
                .cloned()
                .collect();
            ensure(new == promised(row), || {
                format!("{new:?} instead of {:?}", promised(row))
            })?;
            check_files(row, at, count)?;
            if row.is("json", "yes") {
                let text = String::from_utf8_lossy(&first.stdout);
                for line in text.lines() {
                    check_report(
                        &serde_json::from_str(line).map_err(|e| e.to_string())?,
                        count,
                    )?;
                }
            }
            let again = run(at, &args, stdin.as_ref());
            let code = check_words(&again)?;
            ensure(code == 0, || {
                String::from_utf8_lossy(&again.stderr).into_owned()
            })?;
            let mut now = files(at);
            // Reports contain times.
            now.retain(|name, _| !has_ending(name, "json"));
            let changed: Vec<_> = now
                .iter()
                .filter(|(name, bytes)| after[*name] != **bytes)
                .collect();
            ensure(changed.is_empty(), || {
                format!("{} files changed", changed.len())
            })?;
            if row.is("output", "pipe") && !row.is("formats", "json") {
                ensure(first.stdout == again.stdout, || "another result".into())?;
                ensure(!first.stdout.is_empty(), || "no result".into())?;
            }
            done.lock().unwrap().0 += 1;
            Ok(())
        },
    );
    let (done, refused) = done.into_inner().unwrap();
    assert!(
        done >= 20 && refused >= 10,
        "{done} done, {refused} refused"
    );
}

const EVAL: [Factor; 9] = [
    ("method", &["lsdc,linear", "nearest", "lsdc"]),
    ("points", &["60", "grid:8", "bernoulli:60", "corners:30"]),
    ("noise", &["", "added:0.3:0.2", "outliers:0.1"]),
    ("seeds", &["1", "2"]),
    ("shard", &["0/1", "0/2", "1/2"]),
    ("fit", &["lse", "field", "joint"]),
    ("robust", &["none", "huber"]),
    ("uncertainty", &["", "yes"]),
    ("output", &["folder", "files"]),
];

#[test]
fn every_pair_of_flags_of_eval() {
    each(
        &EVAL,
        |_| false,
        |row, at| {
            let frames = 3;
            let fixed = "eval --dataset rooms --set data.rooms.width=48 --set data.rooms.height=36 \
                     --weights small --limit 3";
            let mut args: Vec<String> = fixed.split_whitespace().map(str::to_owned).collect();
            for name in [
                "method", "points", "noise", "seeds", "shard", "fit", "robust",
            ] {
                if !row.is(name, "") {
                    args.extend([format!("--{name}"), row.of(name).to_owned()]);
                }
            }
            if row.is("uncertainty", "yes") {
                args.push("--uncertainty".into());
            }
            let shard: Shard = row.of("shard").parse().unwrap();
            let outputs = match row.of("output") {
                "folder" => "-o run",
                _ => "--json r.json --csv r.csv --html r.html --save saved",
            };
            args.extend(outputs.split(' ').map(str::to_owned));
            let ours = (0..frames)
                .filter(|i| shard.holds(&format!("val/{i:05}")))
                .count();
            let first = run(at, &args, None);
            let code = check_words(&first)?;
            ensure(code == 0, || {
                String::from_utf8_lossy(&first.stderr).into_owned()
            })?;
            let report = match (row.of("output"), shard == Shard::WHOLE) {
                ("files", _) => at.join("r.json"),
                (_, true) => at.join("run/report.json"),
                (_, false) => at.join(format!("run/{shard}/report.json")),
            };
            let read = json(&report);
            let seeds: usize = row.of("seeds").parse().unwrap();
            let found = read["frames"].as_array().unwrap();
            ensure(found.len() == ours * seeds, || {
                format!("{} frames", found.len())
            })?;
            for frame in found {
                for (method, scores) in frame["scores"].as_object().unwrap() {
                    let rmse = scores["rmse"].as_f64().unwrap_or(f64::NAN);
                    ensure(rmse > 0.0 && rmse.is_finite(), || {
                        format!("{method}: {rmse}")
                    })?;
                }
            }
            let before = files(at);
            let again = run(at, &args, None);
            let said = String::from_utf8_lossy(&again.stderr);
            let code = check_words(&again)?;
            ensure(files(at) == before, || "files changed".into())?;
            if row.is("output", "files") {
                return ensure(code == 2 && said.contains("exists"), || said.into_owned());
            }
            let kept = format!("{} results of an earlier run", ours * seeds);
            ensure(code == 0 && (ours == 0 || said.contains(&kept)), || {
                said.into_owned()
            })?;
            ensure(again.stdout == first.stdout, || "another table".into())
        },
    );
}
