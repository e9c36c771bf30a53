//! `lsdc inspect`: what is in files, folders and datasets.

use super::args::Inspect;
use super::network::open_completer;
use super::{Exit, recordings, settings, ui, weights};
use lsdc_eval::data::{Contents, DepthMap, Split, View, check_output, read_rgb, write_atomically};
use lsdc_eval::report::contact_sheet;
use lsdc_eval::report::{coloured, usual_range};
use lsdc_files::error::{Error, Result};
use lsdc_recordings::Recording;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// Bars of a histogram, and the length of the longest.
const BARS: usize = 10;
const LONGEST: usize = 40;
/// Width of a picture on the terminal, in characters.
const ACROSS: usize = 72;

pub(super) fn run(args: &Inspect) -> Result<Exit> {
    if args.source.dataset.is_some() {
        return dataset(args);
    }
    if let Some(sheet) = &args.bases {
        return bases(args, sheet);
    }
    for (number, path) in args.files.iter().enumerate() {
        if number > 0 && !args.json {
            ui::print("");
        }
        if path.extension().is_some_and(|e| e == "safetensors") {
            weights::info(Some(path), args.json)?;
            continue;
        }
        if Recording::is_at(path) {
            recordings::inspect(path, args.json)?;
            continue;
        }
        let contents = Contents::read(path, args.depth_unit)?;
        if args.json {
            ui::print(&described(path, &contents).to_string());
            continue;
        }
        ui::print(&format!("file      {}", path.display()));
        for line in lines(&contents) {
            ui::print(&line);
        }
        if let Some(map) = contents.map().filter(|_| args.show) {
            ui::print(&picture(map));
        }
    }
    Ok(Exit::Done)
}

/// A contact sheet of basis functions.
fn bases(args: &Inspect, sheet: &Path) -> Result<Exit> {
    let [image] = &args.files[..] else {
        return Err(Error::config("`--bases` is for one image"));
    };
    let vector = match sheet.extension().and_then(|e| e.to_str()) {
        Some("svg") => true,
        Some("png") => false,
        _ => {
            return Err(Error::config(format!(
                "`{}` is neither .svg nor .png",
                sheet.display()
            )));
        }
    };
    check_output(sheet, args.force)?;
    let completer = open_completer(args.weights.as_deref(), "cpu", false)?;
    let drawing = contact_sheet(&completer, &read_rgb(image)?)?;
    let bytes = if vector {
        drawing.document().into_bytes()
    } else {
        drawing.png()?
    };
    write_atomically(sheet, |out| out.write_all(&bytes))?;
    ui::tell(&format!("written   {}", sheet.display()));
    Ok(Exit::Done)
}

/// The frames of each split that is there, and the first of them.
fn dataset(args: &Inspect) -> Result<Exit> {
    let mut config = args.settings.load()?.data;
    args.source.apply(&mut config);
    let splits = [Split::Train, Split::Val];
    let found = splits.map(|split| settings::open(&config, split));
    if found.iter().all(Result::is_err) {
        let [train, _] = found;
        return train.map(|_| Exit::Done);
    }
    for (split, frames) in splits.into_iter().zip(found) {
        let frames = match frames {
            Ok(frames) => frames,
            Err(error) => {
                ui::print(&format!("{:<9} none: {error}", split.name()));
                continue;
            }
        };
        ui::print(&format!(
            "{:<9} {}, {}",
            split.name(),
            ui::counted(frames.len(), "frame"),
            frames.description()
        ));
        let frame = frames.load(0)?;
        let depth = &frame.depth;
        let share = depth.count() as f64 / (depth.width() * depth.height()) as f64;
        let (low, high) = depth.range().unwrap_or_default();
        ui::print(&format!(
            "first     {}, {}x{}, {:.1} % of its pixels have depths, {low:.3} to {high:.3} m",
            frames.id(0),
            depth.width(),
            depth.height(),
            share * 100.0
        ));
    }
    Ok(Exit::Done)
}

fn lines(contents: &Contents) -> Vec<String> {
    let mut lines = Vec::new();
    match contents {
        Contents::Image {
            size,
            kind,
            orientation,
            remarks,
        } => {
            lines.push(format!("image     {}x{}, {kind}", size.0, size.1));
            if !orientation.is_upright() {
                let (width, height) = orientation.upright();
                let exif = orientation.exif();
                lines.push(format!(
                    "upright   {width}x{height} (EXIF orientation {exif})"
                ));
            }
            lines.extend(remarks.iter().map(|remark| format!("warning   {remark}")));
        }
        Contents::Map(map) => {
            let depth = &map.depth;
            let (width, height) = (depth.width(), depth.height());
            let share = depth.count() as f64 / (width * height) as f64;
            lines.push(format!(
                "depths    {width}x{height}, {} ({:.2} %), {} ignored",
                ui::counted(depth.count(), "pixel"),
                share * 100.0,
                depth.ignored()
            ));
            let guess = if map.guessed { " (a guess)" } else { "" };
            lines.push(format!("unit      {}{guess}", map.unit));
            if map.sigma.is_some() {
                lines.push("sigma     with standard deviations".to_owned());
            }
            let remarks = map.remarks.iter();
            lines.extend(remarks.map(|remark| format!("warning   {remark}")));
        }
        Contents::List {
            points,
            ignored,
            deviations,
            unit,
            named,
        } => {
            let with = if *deviations {
                ", with standard deviations"
            } else {
                ""
            };
            lines.push(format!(
                "points    {}, {ignored} ignored{with}",
                points.len()
            ));
            if !named {
                let what = "columns   u, v, depth if these are pixels; nothing in the file says so";
                lines.push(what.to_owned());
            }
            lines.push(format!("unit      {unit}"));
            for (axis, name) in ["columns", "rows"].into_iter().enumerate() {
                let values = points.iter().map(|point| point[axis]);
                let low = values.clone().fold(f64::INFINITY, f64::min);
                let high = values.fold(f64::NEG_INFINITY, f64::max);
                lines.push(format!("{name:<9} {low:.1} to {high:.1}"));
            }
        }
        Contents::Cloud {
            count,
            ignored,
            low,
            high,
        } => {
            lines.push(format!(
                "cloud     {}, {ignored} without a place",
                ui::counted(*count, "point")
            ));
            for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                lines.push(format!("{name:<9} {:.3} to {:.3}", low[axis], high[axis]));
            }
        }
        Contents::Model(model) => {
            let seen = model.views.iter().map(View::count);
            lines.push(format!(
                "model     {}, {} of points",
                ui::counted(model.views.len(), "image"),
                ui::counted(seen.sum::<usize>(), "observation")
            ));
        }
        Contents::Camera(camera) => lines.push(format!("camera    {camera}")),
    }
    let mut depths = contents.depths();
    if !depths.is_empty() {
        depths.sort_by(f32::total_cmp);
        let at = |share: f64| depths[((depths.len() - 1) as f64 * share).round() as usize];
        lines.push(format!(
            "range     {:.3} to {:.3} m, half of them below {:.3}",
            at(0.0),
            at(1.0),
            at(0.5)
        ));
        lines.extend(histogram(&depths));
    }
    lines
}

/// Bars of equal width between the least and the greatest of sorted values.
fn histogram(sorted: &[f32]) -> Vec<String> {
    let counts = counts(sorted);
    let most = counts.iter().copied().max().unwrap_or(1).max(1);
    let (low, high) = (sorted[0], sorted[sorted.len() - 1]);
    let width = (high - low) / BARS as f32;
    let bar = |(i, &count): (usize, &usize)| {
        let length = (count * LONGEST).div_ceil(most);
        let start = low + i as f32 * width;
        format!("{start:>9.3} {} {count}", "#".repeat(length))
    };
    counts.iter().enumerate().map(bar).collect()
}

fn counts(sorted: &[f32]) -> [usize; BARS] {
    let (low, high) = (sorted[0], sorted[sorted.len() - 1]);
    let mut counts = [0; BARS];
    for value in sorted {
        let share = (value - low) / (high - low).max(f32::MIN_POSITIVE);
        counts[((share * BARS as f32) as usize).min(BARS - 1)] += 1;
    }
    counts
}

fn described(path: &Path, contents: &Contents) -> Value {
    let mut value = match contents {
        Contents::Image {
            size,
            kind,
            orientation,
            remarks,
        } => json!({
            "is": "image", "width": size.0, "height": size.1, "kind": kind,
            "orientation": orientation.exif(),
            "upright": [orientation.upright().0, orientation.upright().1], "remarks": remarks,
        }),
        Contents::Map(map) => json!({
            "is": "map", "width": map.depth.width(), "height": map.depth.height(),
            "points": map.depth.count(), "ignored": map.depth.ignored(),
            "unit": map.unit.to_string(), "unit_guessed": map.guessed,
            "deviations": map.sigma.is_some(), "remarks": map.remarks,
        }),
        Contents::List {
            points,
            ignored,
            deviations,
            unit,
            named,
        } => json!({
            "is": "list", "points": points.len(), "ignored": ignored,
            "unit": unit.to_string(), "deviations": deviations, "named": named,
        }),
        Contents::Cloud {
            count,
            ignored,
            low,
            high,
        } => json!({
            "is": "cloud", "points": count, "ignored": ignored, "low": low, "high": high,
        }),
        Contents::Model(model) => json!({
            "is": "model", "images": model.views.len(),
            "points": model.views.iter().map(View::count).sum::<usize>(),
        }),
        Contents::Camera(camera) => json!({ "is": "camera", "camera": camera.to_string() }),
    };
    let mut depths = contents.depths();
    if !depths.is_empty() {
        depths.sort_by(f32::total_cmp);
        value["lowest"] = json!(depths[0]);
        value["highest"] = json!(depths[depths.len() - 1]);
        value["histogram"] = json!(counts(&depths));
    }
    value["file"] = json!(path.display().to_string());
    value
}

/// Two rows to a character, one above the other; of the depths in a place the nearest is seen.
fn picture(map: &DepthMap) -> String {
    let across = ACROSS.min(map.width());
    let down = (across * map.height()).div_ceil(map.width());
    let down = down.next_multiple_of(2);
    let mut nearest = vec![0.0_f32; across * down];
    for point in map.points() {
        let (x, y) = (
            point.x * across / map.width(),
            point.y * down / map.height(),
        );
        let here = &mut nearest[y * across + x];
        if *here == 0.0 || point.depth < *here {
            *here = point.depth;
        }
    }
    let (low, high) = usual_range(map).unwrap_or((0.0, 1.0));
    let small = DepthMap::new(across, down, nearest);
    let image = small.map(|small| coloured(&small, low, high));
    let image = image.unwrap_or_default();
    let mut text = String::new();
    for y in (0..image.height()).step_by(2) {
        for x in 0..image.width() {
            let ([r, g, b], [s, h, c]) = (image.get_pixel(x, y).0, image.get_pixel(x, y + 1).0);
            let _ = write!(text, "\x1b[38;2;{r};{g};{b};48;2;{s};{h};{c}m\u{2580}");
        }
        text += "\x1b[0m\n";
    }
    text
}
