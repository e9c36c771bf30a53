//! Images with projected laser scanner returns: `NAME.jpg` or `.png`, and `NAME_points.npz` with the lists `u`, `v`, `depth`
//! and, if known, `ring`.

use super::listing::files_below;
use crate::data::{Dataset, DepthMap, Environment, Frame, FrameId, read_upright};
use lsdc_files::checks::NumberType;
use lsdc_files::error::{Error, Result};
use lsdc_files::{NumberList, has_ending, image_size, read_npz_lists};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Suffix that replaces the file extension of an image in the name of its returns.
const RETURNS: &str = "_points.npz";

/// Laser scans, sorted by name.
pub(in crate::data) struct Scans {
    scans: Vec<ScanFiles>,
    about: OnceLock<String>,
}

struct ScanFiles {
    id: FrameId,
    image: PathBuf,
    returns: PathBuf,
}

/// Opens all scans below `root`, at any depth of folders; every split contains all scans. Images without returns are skipped.
///
/// # Errors
/// A folder that cannot be read, or no scan.
pub(in crate::data) fn scans(root: &Path) -> Result<Scans> {
    let names = files_below(root, None)?;
    let known: BTreeSet<&str> = names.iter().map(String::as_str).collect();
    let scans: Vec<ScanFiles> = names
        .iter()
        .filter(|name| {
            ["jpg", "jpeg", "png"]
                .into_iter()
                .any(|e| has_ending(Path::new(name), e))
        })
        .filter_map(|name| {
            let (id, _) = name.rsplit_once('.')?;
            let returns = format!("{id}{RETURNS}");
            known.contains(returns.as_str()).then(|| ScanFiles {
                id: id.to_owned(),
                image: root.join(name),
                returns: root.join(returns),
            })
        })
        .collect();
    if scans.is_empty() {
        return Err(
            Error::config(format!("no laser scan in `{}`", root.display()))
                .hint("expected images NAME.jpg or NAME.png, and NAME_points.npz beside them"),
        );
    }
    Ok(Scans {
        scans,
        about: OnceLock::new(),
    })
}

impl Dataset for Scans {
    /// The first call reads the returns of all scans to count them.
    fn description(&self) -> String {
        let count = |files: &ScanFiles| {
            // An unreadable file is an error of its frame.
            let size = image_size(&files.image).ok()?;
            Some(Returns::read(&files.returns, size).ok()?.counts)
        };
        let describe = || {
            let counts = self.scans.par_iter().filter_map(count);
            let counts = counts.reduce(Counts::default, Counts::plus);
            format!("laser scans (NAME{RETURNS} beside images), {counts}")
        };
        self.about.get_or_init(describe).clone()
    }

    fn protocol(&self) -> &'static str {
        "scans"
    }

    fn len(&self) -> usize {
        self.scans.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.scans[index].id.clone()
    }

    fn files(&self, index: usize) -> Vec<PathBuf> {
        let files = &self.scans[index];
        vec![files.image.clone(), files.returns.clone()]
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let files = &self.scans[index];
        let image = read_upright(&files.image)?;
        if !image.orientation.is_upright() {
            let what =
                "is turned by its EXIF record, so that its returns would lie on other pixels";
            return Err(Error::format(&files.image, what).hint("save it upright"));
        }
        let size = (image.rgb.width() as usize, image.rgb.height() as usize);
        let returns = Returns::read(&files.returns, size)?;
        let frame = Frame::new(files.id.clone(), image.rgb, returns.depth.clone())?;
        let mut frame = frame
            .with_sparse(returns.depth)?
            .with_rings(returns.rings)?;
        frame.place = Environment::Outdoor;
        Ok(frame)
    }
}

/// The returns of a scan, assigned to pixels.
struct Returns {
    depth: DepthMap,
    rings: Vec<i32>,
    counts: Counts,
}

/// Number of returns of a scan, and numbers of returns dropped, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Counts {
    all: usize,
    /// Outside the image.
    outside: usize,
    /// Inside the image, without a positive, finite depth.
    without_depth: usize,
    /// Behind another return in the same pixel.
    behind: usize,
}

impl Counts {
    fn plus(self, other: Self) -> Self {
        Self {
            all: self.all + other.all,
            outside: self.outside + other.outside,
            without_depth: self.without_depth + other.without_depth,
            behind: self.behind + other.behind,
        }
    }
}

impl std::fmt::Display for Counts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} returns; left out: {} outside of the image, {} without a positive depth, {} behind another one in their pixel",
            self.all, self.outside, self.without_depth, self.behind
        )
    }
}

impl Returns {
    /// Reads the returns of an image of this width and height.
    fn read(path: &Path, (width, height): (usize, usize)) -> Result<Self> {
        let [u, v, depth, ring] = read_npz_lists(path, ["u", "v", "depth", "ring"])?;
        let required = |name: &str, list: Option<NumberList>| {
            list.ok_or_else(|| {
                Error::format(path, format!("has no array `{name}`"))
                    .hint("save `u`, `v` (pixels) and `depth` (metres), one number for each return")
            })
        };
        let (u, v, depth) = (
            required("u", u)?,
            required("v", v)?,
            required("depth", depth)?,
        );
        let count = depth.values.len();
        let lists = [("u", Some(&u)), ("v", Some(&v)), ("ring", ring.as_ref())];
        for (name, list) in lists {
            if let Some(list) = list.filter(|list| list.values.len() != count) {
                let own = list.values.len();
                let what = format!("has {own} values of `{name}` but {count} of `depth`");
                return Err(Error::format(path, what).hint("save one of each for each return"));
            }
        }
        if ring
            .as_ref()
            .is_some_and(|ring| ring.numbers == NumberType::Floats)
        {
            return Err(
                Error::format(path, "has rings that are no integers").hint("save `ring` as int16")
            );
        }
        let mut depths = vec![0.0_f32; width * height];
        let mut rings = vec![-1; width * height];
        let mut counts = Counts {
            all: count,
            ..Counts::default()
        };
        // A pixel extends half a pixel to either side of its centre.
        let pixel = |at: f32, length: usize| {
            let at = (f64::from(at) + 0.5).floor();
            (0.0..length as f64).contains(&at).then_some(at as usize)
        };
        for i in 0..count {
            let depth = depth.values[i];
            let Some((x, y)) = pixel(u.values[i], width).zip(pixel(v.values[i], height)) else {
                counts.outside += 1;
                continue;
            };
            if !(depth > 0.0 && depth.is_finite()) {
                counts.without_depth += 1;
                continue;
            }
            let at = y * width + x;
            let previous = depths[at];
            counts.behind += usize::from(previous > 0.0);
            if previous == 0.0 || depth < previous {
                depths[at] = depth;
                let known = ring.as_ref().map_or(-1.0, |ring| ring.values[i]);
                rings[at] = (known as i32).max(-1);
            }
        }
        if counts.outside + counts.without_depth == count {
            let what = format!("has no return that can be used of {counts}");
            return Err(Error::format(path, what)
                .hint("`u` and `v` are pixels of the image beside it, `depth` metres along the optical axis"));
        }
        Ok(Self {
            depth: DepthMap::new(width, height, depths)?,
            rings,
            counts,
        })
    }
}
