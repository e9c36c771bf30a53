//! Sampling patterns of sparse points over the valid pixels of a frame.

use super::corners::strongest;
use super::scanner::{BEAMS, returns};
use super::{HoldOut, Size};
use crate::data::{DepthMap, Frame, Point, read_depth};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use std::path::PathBuf;
use std::str::FromStr;

/// A sampling pattern for sparse points of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PatternConfig", into = "String")]
pub enum Pattern {
    /// Exactly this many pixels, uniform without replacement among the valid ones (as in NLSPN); all of them if there are
    /// fewer.
    Exactly(usize),
    /// Every valid pixel, with the probability that gives this expected number (as in sparse-to-dense).
    Bernoulli(usize),
    /// Every pixel, with the probability that would give this expected number if all were valid (as in CSPN).
    BernoulliAll(usize),
    /// The valid pixels of a square grid with this step, offset by half a step from the upper left corner.
    Grid(usize),
    /// The valid pixels of this many evenly spaced rows, like a laser scanner.
    Lines(usize),
    /// The valid pixels at the strongest corners of the image (Shi and Tomasi 1994), like visual odometry; the seed has no
    /// effect.
    Corners(usize),
    /// Exactly this many pixels, uniform among the valid ones of a random half: left, right, upper or lower.
    Half(usize),
    /// Exactly this many pixels, uniform among the valid ones in eight square blocks, the blocks of [`HoldOut::Clusters`].
    Clusters(usize),
    /// The returns of a spinning laser scanner with this many beams, 4 to 128, beside a camera with a horizontal field of view
    /// of 80 degrees: elevations of real scanners, azimuth steps of 0.2 degrees, lost returns, noise, and background seen past
    /// edges.
    Scanner(usize),
    /// The points provided by the dataset.
    Given,
    /// Points read from `FRAME.npy` or `FRAME.png` (millimetres) in this folder.
    Files(PathBuf),
}

impl Pattern {
    /// Draws the points of `frame` under `seed`; the same on every machine and for every method.
    ///
    /// # Errors
    /// Points that do not exist, or do not have the size of the frame.
    pub fn draw(&self, frame: &Frame, seed: u64) -> Result<DepthMap> {
        let depth = &frame.depth;
        let mut rng = Rng::stream(seed, &["pattern", &frame.id]);
        let points: Vec<Point> = match self {
            Self::Exactly(count) => chosen(depth.points().collect(), *count, &mut rng),
            Self::Bernoulli(count) => {
                let share = *count as f32 / depth.count().max(1) as f32;
                depth.points().filter(|_| rng.chance(share)).collect()
            }
            Self::BernoulliAll(count) => {
                let share = *count as f32 / depth.values().len() as f32;
                let selected = depth.values().iter().map(|_| rng.chance(share));
                let selected: Vec<bool> = selected.collect();
                depth
                    .points()
                    .filter(|p| selected[p.y * depth.width() + p.x])
                    .collect()
            }
            Self::Grid(step) => {
                let on = |i: usize| i % step == step / 2;
                depth.points().filter(|p| on(p.x) && on(p.y)).collect()
            }
            Self::Lines(count) => {
                let rows: Vec<usize> = (0..*count)
                    .map(|i| (2 * i + 1) * depth.height() / (2 * count))
                    .collect();
                depth.points().filter(|p| rows.contains(&p.y)).collect()
            }
            Self::Corners(count) => strongest(&frame.rgb)
                .into_iter()
                .map(|(x, y)| Point {
                    x,
                    y,
                    depth: depth.at(x, y),
                })
                .filter(|p| p.depth > 0.0)
                .take(*count)
                .collect(),
            Self::Half(count) => {
                let in_half = random_half(frame, seed);
                chosen(depth.points().filter(in_half).collect(), *count, &mut rng)
            }
            Self::Clusters(count) => {
                let inside = HoldOut::clusters(frame, CLUSTERS, &mut rng);
                let points = depth.points();
                let points = points.filter(|p| inside[p.y * depth.width() + p.x]);
                chosen(points.collect(), *count, &mut rng)
            }
            Self::Scanner(beams) => returns(frame, *beams, &mut rng),
            Self::Given => {
                return frame.sparse.clone().ok_or_else(|| {
                    Error::config(format!("frame `{}` comes without sparse points", frame.id))
                        .hint("draw them: --points 500")
                });
            }
            Self::Files(folder) => return from_file(folder, frame),
        };
        Ok(DepthMap::from_points(
            depth.width(),
            depth.height(),
            &points,
        ))
    }
}

/// Number of blocks of `clusters:N`.
const CLUSTERS: usize = 8;

/// Returns this many random points; all of them if there are fewer.
fn chosen(mut points: Vec<Point>, count: usize, rng: &mut Rng) -> Vec<Point> {
    rng.choose(&mut points, count);
    points.truncate(count);
    points
}

/// Returns a test whether a point lies in a random half of a frame.
fn random_half(frame: &Frame, seed: u64) -> impl Fn(&Point) -> bool {
    let (height, width) = (frame.depth.height(), frame.depth.width());
    let side = Rng::stream(seed, &["half", &frame.id]).below(4);
    move |point| match side {
        0 => 2 * point.x < width,
        1 => 2 * point.x >= width,
        2 => 2 * point.y < height,
        _ => 2 * point.y >= height,
    }
}

fn from_file(folder: &std::path::Path, frame: &Frame) -> Result<DepthMap> {
    let npy = folder.join(format!("{}.npy", frame.id));
    let png = folder.join(format!("{}.png", frame.id));
    let (path, scale) = if png.is_file() {
        (png, 0.001)
    } else {
        (npy, 1.0)
    };
    let sparse = read_depth(&path, scale)?;
    if Size::of(&sparse) != Size::of(&frame.depth) {
        return Err(Error::shape(format!(
            "`{}` is {}x{} but the frame is {}x{}",
            path.display(),
            sparse.width(),
            sparse.height(),
            frame.depth.width(),
            frame.depth.height()
        ))
        .hint("points belong to the frame after the protocol's resizing and cropping"));
    }
    Ok(sparse)
}

impl Display for Pattern {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Exactly(n) => write!(f, "exactly {n} uniform valid pixels"),
            Self::Bernoulli(n) => write!(f, "each valid pixel by chance, {n} expected"),
            Self::BernoulliAll(n) => write!(f, "each pixel by chance, {n} expected if all valid"),
            Self::Grid(step) => write!(f, "a grid of step {step}"),
            Self::Lines(n) => write!(f, "{n} rows"),
            Self::Corners(n) => write!(f, "the {n} strongest corners"),
            Self::Half(n) => write!(f, "exactly {n} uniform valid pixels of one half"),
            Self::Clusters(n) => {
                write!(f, "exactly {n} uniform valid pixels of {CLUSTERS} blocks")
            }
            Self::Scanner(n) => write!(f, "the returns of a scanner of {n} beams"),
            Self::Given => write!(f, "the dataset's own"),
            Self::Files(folder) => write!(f, "from `{}`", folder.display()),
        }
    }
}

impl FromStr for Pattern {
    type Err = Error;

    /// Parses `500`, `LAW:N`, `given` or `files:DIR`.
    fn from_str(text: &str) -> Result<Self> {
        let wrong = || {
            Error::config(format!("`{text}` is no pattern of points")).hint(
                "N, exactly:N, bernoulli:N, bernoulli-all:N, grid:STEP, lines:N, corners:N, \
                 half:N, clusters:N, scanner:BEAMS (4 to 128), given, files:DIR",
            )
        };
        let (law, value) = text.split_once(':').unwrap_or((text, ""));
        let number = |t: &str| t.parse().ok().filter(|&n| n > 0).ok_or_else(wrong);
        Ok(match law {
            "exactly" => Self::Exactly(number(value)?),
            "bernoulli" => Self::Bernoulli(number(value)?),
            "bernoulli-all" => Self::BernoulliAll(number(value)?),
            "grid" => Self::Grid(number(value)?),
            "lines" => Self::Lines(number(value)?),
            "corners" => Self::Corners(number(value)?),
            "half" => Self::Half(number(value)?),
            "clusters" => Self::Clusters(number(value)?),
            "scanner" => {
                let beams = Some(number(value)?).filter(|beams| BEAMS.contains(beams));
                Self::Scanner(beams.ok_or_else(wrong)?)
            }
            "given" if value.is_empty() => Self::Given,
            "files" if !value.is_empty() => Self::Files(value.into()),
            _ => Self::Exactly(number(text)?),
        })
    }
}

impl From<Pattern> for String {
    fn from(pattern: Pattern) -> Self {
        match pattern {
            Pattern::Exactly(n) => format!("exactly:{n}"),
            Pattern::Bernoulli(n) => format!("bernoulli:{n}"),
            Pattern::BernoulliAll(n) => format!("bernoulli-all:{n}"),
            Pattern::Grid(n) => format!("grid:{n}"),
            Pattern::Lines(n) => format!("lines:{n}"),
            Pattern::Corners(n) => format!("corners:{n}"),
            Pattern::Half(n) => format!("half:{n}"),
            Pattern::Clusters(n) => format!("clusters:{n}"),
            Pattern::Scanner(n) => format!("scanner:{n}"),
            Pattern::Given => "given".into(),
            Pattern::Files(folder) => format!("files:{}", folder.display()),
        }
    }
}

/// A pattern in a configuration: text or a number of points.
#[derive(Deserialize)]
#[serde(untagged)]
enum PatternConfig {
    Count(usize),
    Text(String),
}

impl TryFrom<PatternConfig> for Pattern {
    type Error = Error;

    fn try_from(written: PatternConfig) -> Result<Self> {
        match written {
            PatternConfig::Count(count) => count.to_string().parse(),
            PatternConfig::Text(text) => text.parse(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    /// A ramp in which every third pixel has no depth.
    fn ramp(id: &str) -> Frame {
        let values = (0..1200).map(|i| if i % 3 == 0 { 0.0 } else { i as f32 });
        let depth = DepthMap::new(40, 30, values.collect()).unwrap();
        Frame::new(id.into(), RgbImage::new(40, 30), depth).unwrap()
    }

    fn draw(pattern: &str, frame: &Frame, seed: u64) -> DepthMap {
        let pattern: Pattern = pattern.parse().unwrap();
        pattern.draw(frame, seed).unwrap()
    }

    #[test]
    fn points_are_a_subset_of_the_right_size() {
        let frame = ramp("a");
        for pattern in [
            "500",
            "bernoulli:500",
            "bernoulli-all:500",
            "grid:4",
            "lines:3",
        ] {
            let sparse = draw(pattern, &frame, 0);
            assert!(sparse.points().all(|p| p.depth == frame.depth.at(p.x, p.y)));
        }
        assert_eq!(draw("500", &frame, 0).count(), 500);
        assert_eq!(draw("5000", &frame, 0), frame.depth);
    }

    #[test]
    fn chances_have_their_expectation() {
        let frame = ramp("a");
        let mean = |pattern: &str| {
            (0..200)
                .map(|seed| draw(pattern, &frame, seed).count())
                .sum::<usize>() as f64
                / 200.0
        };
        // 200 draws of a binomial with mean 200: the standard deviation of the mean is below 0.9.
        assert!((mean("bernoulli:200") - 200.0).abs() < 4.0);
        assert!((mean("bernoulli-all:200") - 200.0 * 2.0 / 3.0).abs() < 4.0);
    }

    #[test]
    fn grids_and_rows_are_where_they_should_be() {
        let frame = ramp("a");
        assert!(
            draw("grid:4", &frame, 0)
                .points()
                .all(|p| p.x % 4 == 2 && p.y % 4 == 2)
        );
        let rows: std::collections::BTreeSet<usize> =
            draw("lines:3", &frame, 0).points().map(|p| p.y).collect();
        assert_eq!(rows.into_iter().collect::<Vec<_>>(), [5, 15, 25]);
    }

    #[test]
    fn one_half_has_all_points() {
        let frame = ramp("a");
        let mut sides = std::collections::BTreeSet::new();
        for seed in 0..40 {
            let sparse = draw("half:50", &frame, seed);
            assert_eq!(sparse.count(), 50);
            let halves: [&dyn Fn(&Point) -> bool; 4] =
                [&|p| p.x < 20, &|p| p.x >= 20, &|p| p.y < 15, &|p| p.y >= 15];
            let side = halves
                .iter()
                .position(|half| sparse.points().all(|p| half(&p)));
            sides.insert(side.unwrap());
        }
        assert_eq!(sides.len(), 4);
    }

    #[test]
    fn clusters_are_blocks_and_scanners_read_valid_pixels_alone() {
        let frame = ramp("a");
        assert_eq!(draw("clusters:10", &frame, 0).count(), 10);
        // Eight valid centres, and at most two valid pixels in each row of blocks of 3x3.
        for seed in 0..20 {
            let all = draw("clusters:5000", &frame, seed).count();
            assert!((8..=48).contains(&all), "{all}");
        }
        let scan = draw("scanner:64", &frame, 0);
        assert_eq!(scan, draw("scanner:64", &frame, 0));
        assert_ne!(scan, draw("scanner:64", &frame, 1));
        assert!(scan.count() > 0);
        assert!(scan.points().all(|p| frame.depth.at(p.x, p.y) > 0.0));
    }

    #[test]
    fn masks_depend_on_seed_and_frame_alone() {
        let draw = |seed, id| draw("50", &ramp(id), seed);
        assert_eq!(draw(0, "a"), draw(0, "a"));
        assert_ne!(draw(0, "a"), draw(1, "a"));
        assert_ne!(draw(0, "a"), draw(0, "b"));
    }

    #[test]
    fn patterns_are_written_as_they_are_read() {
        for text in [
            "exactly:7",
            "bernoulli-all:9",
            "given",
            "files:a/b",
            "corners:3",
            "half:20",
            "clusters:30",
            "scanner:64",
        ] {
            let pattern: Pattern = text.parse().unwrap();
            assert_eq!(String::from(pattern), text);
        }
        for wrong in [
            "0",
            "grid:0",
            "files:",
            "given:3",
            "many",
            "lines:x",
            "scanner:3",
            "scanner:129",
        ] {
            assert!(wrong.parse::<Pattern>().is_err(), "{wrong}");
        }
        assert!(Pattern::Given.draw(&ramp("a"), 0).is_err());
    }
}
