//! A completed frame in words.

use super::summary::Summary;
use super::views::DescribedViews;
use crate::cli::ui::{self, counted};
use lsdc_files::DescribedFit;
use std::path::Path;
use std::time::Duration;

impl Summary {
    /// Lines of the summary, starting with the expected error. `list` is the file of the outliers, if there is one.
    pub(super) fn lines(&self, list: Option<&Path>) -> Vec<String> {
        let m = self.metres();
        let mut lines = Vec::new();
        if let Some(fit) = &self.fit {
            lines.push(error(fit, m));
            lines.extend(self.outliers(fit, list));
        }
        if let Some(depth) = &self.depth {
            let clamped = match depth.clamped {
                0 => String::new(),
                count => format!(
                    ", {} far outside the range of the points limited",
                    counted(count, "pixel")
                ),
            };
            lines.push(format!(
                "depth     {:.3} to {:.3} {m}, {}x{}{clamped}",
                depth.lowest, depth.highest, depth.width, depth.height
            ));
        }
        if let Some(left) = self.left_empty {
            let pixels = counted(left.pixels, "pixel");
            let absolute = left.max_sigma.map(|most| format!("{most} {m}"));
            let relative = left.max_relative_sigma;
            let relative = relative.map(|most| format!("{} % of the depth", 100.0 * most));
            let limits: Vec<String> = absolute.into_iter().chain(relative).collect();
            lines.push(format!(
                "empty     {pixels} left empty: standard deviation above {}",
                limits.join(" or ")
            ));
        }
        if let Some((low, high)) = self.color_range {
            lines.push(format!(
                "colours   {low:.3} {m} (blue) to {high:.3} {m} (red)"
            ));
        }
        if let Some(unit) = self.unusual_png_unit() {
            lines.push(format!(
                "png       {unit} to a value: these depths do not fit in millimetres"
            ));
        }
        lines.extend(raised(self.png_raised()));
        if let Some(cloud) = &self.cloud {
            let lost = left_out_of_clouds(self.left_out_of_cloud());
            let lost = lost.map_or(String::new(), |lost| format!(", {lost}"));
            lines.push(format!(
                "cloud     {}{lost}",
                counted(cloud.points, "point")
            ));
        }
        lines.extend(self.input());
        lines.extend(self.views.as_ref().map(of_views));
        if let Some(quality) = self.quality {
            lines.push(format!("quality   {}", quality.name()));
        }
        if let Some(side) = self.encoder_side {
            lines.push(format!("encoder   reads {side} pixels"));
        }
        if let Some(fit) = &self.fit {
            lines.extend(of_fit(fit, self.guide.as_deref()));
        }
        lines.push(self.times());
        lines
    }

    /// Line about points that disagree with the others, where they are listed, and what to do.
    fn outliers(&self, fit: &DescribedFit, list: Option<&Path>) -> Option<String> {
        let count = fit.outliers.filter(|count| *count > 0)?;
        let place = match list {
            Some(path) => format!("listed in {}", path.display()),
            None => "--outliers lists them".to_owned(),
        };
        // A few of many are to be expected, and matter little.
        let many = count >= 3 && 100 * count > self.points.counts.used;
        let remedy = if many && !self.robust {
            "; --robust auto limits their influence"
        } else {
            ""
        };
        let verb = if count == 1 { "disagrees" } else { "disagree" };
        Some(format!(
            "outliers  {} {verb} with the others; {place}{remedy}",
            counted(count, "point")
        ))
    }

    /// Lines about the input.
    fn input(&self) -> Vec<String> {
        let points = &self.points;
        let mut notes: Vec<String> = left_out_of_points(self.left_out_of_points())
            .into_iter()
            .collect();
        if points.deviations_used == Some(false) {
            notes.push("their deviations only weigh points of one pixel in this method".to_owned());
        }
        let note = if notes.is_empty() {
            String::new()
        } else {
            format!(" ({})", notes.join(", "))
        };
        let guess = if points.counts.unit_guessed {
            " (a guess; --depth-unit sets it)"
        } else {
            ""
        };
        let mut lines = vec![
            format!("points    {}{note}", points.counts.used),
            format!("unit      {}{guess}", points.counts.unit),
        ];
        if let Some(noise) = &self.noise {
            let name = noise.name.map_or(String::new(), |name| format!("{name}: "));
            let points = counted(noise.points, "point");
            lines.push(format!("noise     {name}{} m at {points}", noise.formula));
        }
        lines
    }

    fn times(&self) -> String {
        let stages = [
            ("reading", Some(self.seconds.reading)),
            ("guide", self.seconds.guide),
            ("network", self.seconds.network),
            ("fit", self.seconds.fit),
            ("dense", self.seconds.dense),
        ];
        let stages = stages.into_iter().filter_map(|(name, time)| {
            Some(format!(
                "{name} {}",
                ui::millis(Duration::from_secs_f64(time?))
            ))
        });
        format!("time      {}", stages.collect::<Vec<_>>().join(", "))
    }
}

/// The error to expect, and what is left at the points: of inliers, if there are outliers.
fn error(fit: &DescribedFit, m: &str) -> String {
    let Some(all) = fit.leave_one_out else {
        let residual = fit.residual;
        return format!("error     unknown between the points, {residual:.4} {m} at the points");
    };
    let outliers = fit.outliers.unwrap_or(0);
    let inliers = fit.leave_one_out_inliers.zip(fit.residual_inliers);
    let inliers = inliers.filter(|_| outliers > 0);
    let (between, at) = inliers.unwrap_or((all, fit.residual));
    let with = inliers.map_or(String::new(), |_| {
        format!(
            "; {all:.4} and {:.4} {m} with {}",
            fit.residual,
            counted(outliers, "outlier")
        )
    });
    format!(
        "error     {between:.4} {m} to expect between the points (leave-one-out), {at:.4} {m} at the points{with}"
    )
}

/// Line about the points of other images.
fn of_views(views: &DescribedViews) -> String {
    let counts = [
        (views.occluded, "behind the surface"),
        (views.contradicting, "in front of it"),
        (views.doubled, "seen twice"),
        (views.thinned, "too many"),
    ];
    let counts = counts.into_iter().filter(|(count, _)| *count > 0);
    let left_out = counts.map(|(count, reason)| format!("{count} {reason}"));
    let left_out = left_out.collect::<Vec<_>>().join(", ");
    let left_out = if left_out.is_empty() {
        left_out
    } else {
        format!("; left out: {left_out}")
    };
    format!(
        "views     {}: {} of {} agree, {} carried over{left_out}",
        views.outcome,
        views.used,
        counted(views.considered, "other image"),
        counted(views.carried, "point")
    )
}

/// Lines about the guide and the standard deviations.
fn of_fit(fit: &DescribedFit, network: Option<&str>) -> Vec<String> {
    let network = network.map_or(String::new(), |network| format!("{network}; "));
    let guide = fit.guide_trust.map(|trust| {
        if trust > 0.0 {
            format!("guide     {network}used, with weights of about {trust}")
        } else {
            format!("guide     {network}not used: the points do not support it")
        }
    });
    let share = fit.median_share.filter(|share| *share > 0.0);
    let map = share.map(|share| {
        format!(
            "map       {:.0} % of the way from the joint fit to the median with the field alone and the surface of the points",
            100.0 * share
        )
    });
    let sigma = fit.deviations_of_95.map(|deviations| {
        format!(
            "sigma     68.3 % of errors are expected within 1 standard deviation, 95 % within {deviations:.1}"
        )
    });
    let sky = (fit.sky > 0).then(|| {
        let pixels = counted(fit.sky, "pixel");
        format!(
            "sky       {pixels} without a point near: the standard deviation is at least the depth"
        )
    });
    let smoothed = (fit.smoothed > 0).then(|| {
        format!(
            "smoothed  {} by their standard deviations",
            counted(fit.smoothed, "point")
        )
    });
    let limited = (fit.limited > 0).then(|| {
        format!(
            "holes     {} follow the depths around, which basis functions contradict",
            counted(fit.limited, "pixel")
        )
    });
    let all = [guide, map, sigma, sky, smoothed, limited];
    all.into_iter().flatten().collect()
}

/// Line about pixels nearer than half a unit of the PNG, if any.
pub(super) fn raised(count: usize) -> Option<String> {
    let verb = if count == 1 { "holds" } else { "hold" };
    (count > 0).then(|| {
        let pixels = counted(count, "pixel");
        format!("png       {pixels} nearer than half a unit {verb} one")
    })
}

/// Line about the pixels that clouds leave out: uncertain ones, those outside the lens model, flying ones, and those that share
/// a voxel with others.
pub(super) fn left_out_of_clouds(counts: [usize; 4]) -> Option<String> {
    let reasons = [
        "left out: their standard deviation is too large",
        "left out where the lens does not look",
        "left out at depth edges (flying; --keep-flying keeps them)",
        "merged by --voxel",
    ];
    let lost = counts.into_iter().zip(reasons);
    let lost = lost.filter(|(count, _)| *count > 0);
    let texts: Vec<String> = lost
        .map(|(count, reason)| format!("{} {reason}", counted(count, "pixel")))
        .collect();
    (!texts.is_empty()).then(|| texts.join(", "))
}

/// Points that were not fitted, in words.
pub(super) fn left_out_of_points(counts: [usize; 4]) -> Option<String> {
    let reasons = [
        "without a usable depth or standard deviation",
        "outside the image",
        "behind others",
        "without a time, or transforms at it",
    ];
    let left_out = counts.into_iter().zip(reasons);
    let left_out = left_out.filter(|(count, _)| *count > 0);
    let texts: Vec<String> = left_out
        .map(|(count, reason)| format!("{count} {reason}"))
        .collect();
    (!texts.is_empty()).then(|| texts.join(", "))
}
