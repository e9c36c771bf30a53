//! Counts and warnings of many completed frames.

use super::export::ExportCounts;
use super::lines::{left_out_of_clouds, left_out_of_points, raised};
use super::summary::Summary;
use crate::cli::ui::{self, counted};
use indicatif::ProgressBar;
use std::collections::BTreeMap;
use std::path::Path;

/// Prints the warnings of many frames as they are written, and counts for the end.
pub(super) struct Tally<'a> {
    bar: &'a ProgressBar,
    json: bool,
    /// A warning of many frames is printed for the first, and counted. By the remark without its numbers.
    warnings: BTreeMap<String, RepeatedWarning>,
    count: usize,
    unusual_png_units: BTreeMap<String, usize>,
    png_raised: usize,
    left_out_of_points: [usize; 4],
    left_empty: usize,
    left_out_of_clouds: [usize; 4],
    /// With workspaces for other programs.
    exported: Option<ExportCounts>,
    skewed: usize,
    views: ViewsTally,
}

/// Frames with points of other images, and counts of these images.
#[derive(Default)]
struct ViewsTally {
    asked: usize,
    frames: usize,
    used: usize,
    inconsistent: usize,
    carried: usize,
}

/// A remark of one frame or more.
#[derive(Default)]
struct RepeatedWarning {
    frames: usize,
    /// The first frame, and its remark.
    first: String,
}

fn warn(bar: &ProgressBar, warning: &str) {
    bar.suspend(|| ui::warn(&format!("warning: {warning}")));
}

/// A remark with `#` in place of each number: the same remark of another frame has other counts and depths.
fn without_numbers(remark: &str) -> String {
    let mut kind = String::with_capacity(remark.len());
    for letter in remark.chars() {
        match letter {
            '0'..='9' if !kind.ends_with('#') => kind.push('#'),
            '0'..='9' | '.' if kind.ends_with('#') => {}
            _ => kind.push(letter),
        }
    }
    kind
}

impl<'a> Tally<'a> {
    /// Advances `bar` with every frame; with `json` it also prints an object per frame to stdout.
    pub(super) fn new(bar: &'a ProgressBar, json: bool) -> Self {
        Self {
            bar,
            json,
            warnings: BTreeMap::new(),
            count: 0,
            unusual_png_units: BTreeMap::new(),
            png_raised: 0,
            left_out_of_points: [0; 4],
            left_empty: 0,
            left_out_of_clouds: [0; 4],
            exported: None,
            skewed: 0,
            views: ViewsTally::default(),
        }
    }

    /// Takes in a frame that is written.
    pub(super) fn add(&mut self, name: &Path, summary: &Summary) {
        for remark in summary.remarks() {
            let repeated = self.warnings.entry(without_numbers(remark)).or_default();
            if repeated.frames == 0 {
                repeated.first = format!("{}: {remark}", name.display());
                warn(self.bar, &repeated.first);
            }
            repeated.frames += 1;
        }
        self.count += 1;
        if let Some(unit) = summary.unusual_png_unit() {
            *self.unusual_png_units.entry(unit.to_string()).or_default() += 1;
        }
        self.png_raised += summary.png_raised();
        let pairs = self.left_out_of_points.iter_mut();
        let pairs = pairs.zip(summary.left_out_of_points());
        pairs.for_each(|(sum, count)| *sum += count);
        self.left_empty += summary.left_empty();
        let pairs = self.left_out_of_clouds.iter_mut();
        let pairs = pairs.zip(summary.left_out_of_cloud());
        pairs.for_each(|(sum, count)| *sum += count);
        if let Some(counts) = summary.exported {
            self.exported.get_or_insert_default().add(counts);
        }
        self.skewed += usize::from(summary.is_skewed());
        if let Some(views) = &summary.views {
            self.views.asked += 1;
            self.views.frames += usize::from(views.carried > 0);
            self.views.used += if views.carried > 0 { views.used } else { 0 };
            self.views.inconsistent += views.inconsistent;
            self.views.carried += views.carried;
        }
        self.bar.inc(1);
        if self.json {
            self.bar.suspend(|| ui::print(&summary.value().to_string()));
        }
    }

    /// Prints a warning about several frames.
    pub(super) fn warn(&self, warning: &str) {
        warn(self.bar, warning);
    }

    /// Number of frames written.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Prints how many frames there are, and what was left out of them.
    pub(super) fn print_totals(&self, there: usize, failed: usize) {
        let tell = if self.json { ui::say } else { ui::tell };
        let done = self.count;
        tell(&format!(
            "frames    {done} completed, {there} there already, {failed} failed"
        ));
        let repeated = self.warnings.values().filter(|found| found.frames > 1);
        for RepeatedWarning { frames, first } in repeated {
            tell(&format!("remarked  of {frames} frames, the first {first}"));
        }
        if let Some(points) = left_out_of_points(self.left_out_of_points) {
            tell(&format!("points    {points}"));
        }
        let views = &self.views;
        if views.asked > 0 {
            tell(&format!(
                "views     {} points of {} joined {} of {done} frames; {} left out as they contradict the image's points",
                views.carried,
                counted(views.used, "other image"),
                views.frames,
                views.inconsistent
            ));
        }
        if self.skewed > 0 {
            let skewed = self.skewed;
            tell(&format!(
                "deskewed  {} of {done} frames; in {skewed} all points count at the stamp of their cloud",
                done - skewed
            ));
        }
        for (unit, count) in &self.unusual_png_units {
            let verb = if *count == 1 { "holds" } else { "hold" };
            tell(&format!(
                "png       {} {verb} {unit} to a value: the depths do not fit in millimetres",
                counted(*count, "file")
            ));
        }
        if self.left_empty > 0 {
            let pixels = counted(self.left_empty, "pixel");
            tell(&format!(
                "empty     {pixels} left empty: standard deviation above --max-sigma or --max-relative-sigma"
            ));
        }
        if let Some(counts) = self.exported {
            counts.lines().iter().for_each(|line| tell(line));
        }
        let lost = left_out_of_clouds(self.left_out_of_clouds);
        let lost = lost.map(|lost| format!("clouds    {lost}"));
        for line in raised(self.png_raised).into_iter().chain(lost) {
            tell(&line);
        }
    }
}
