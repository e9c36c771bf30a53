//! Where frames of reference are in each other at any time: what tf2 calls its buffer.

use crate::message::{Stamp, TransformStamped};
use crate::rigid::Rigid;
use lsdc_files::error::{Error, Result};
use std::collections::{BTreeMap, HashSet};

/// The frame that robots measure their motion in, without jumps (ROS REP 105): where there is one, motion is measured in
/// it.
const CONTINUOUS: &str = "odom";

/// The transforms of a recording.
#[derive(Debug, Default)]
pub struct Transforms {
    /// By the frame that is in another one.
    links: BTreeMap<String, Link>,
    /// Transforms of a frame whose parent was another one before: these are left out.
    pub elsewhere: usize,
}

/// Where a frame is in its parent.
#[derive(Debug)]
struct Link {
    parent: String,
    is_static: bool,
    /// In the order of time, if it moves; else the last that was said.
    samples: Vec<(Stamp, Rigid)>,
}

/// That the place of a frame is not known at a time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gap {
    child: String,
    parent: String,
    /// Seconds from the time to the nearest transform.
    away: String,
}

impl std::fmt::Display for Gap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            child,
            parent,
            away,
        } = self;
        write!(
            f,
            "`{child}` has no place in `{parent}` at its time, the nearest is {away} s away"
        )
    }
}

/// The way from a frame to another one, over a third that both are in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    /// From each end, the frames on the way to the one that motion is measured in.
    ends: [Vec<String>; 2],
    /// How many of them lead to the first frame that both are in: enough where no time passes.
    short: [usize; 2],
    /// The frame that motion is measured in.
    fixed: String,
}

impl Transforms {
    /// Takes in a transform, which is valid at all times if it is static.
    pub fn add(&mut self, found: TransformStamped, is_static: bool) {
        let link = self.links.entry(found.child).or_insert_with(|| Link {
            parent: found.parent.clone(),
            is_static,
            samples: Vec::new(),
        });
        if link.parent != found.parent {
            self.elsewhere += 1;
            return;
        }
        link.is_static |= is_static;
        if link.is_static {
            link.samples.clear();
        }
        link.samples.push((found.stamp, found.rigid));
    }

    /// Makes ready for [`Self::between`], once all are there.
    pub fn sort(&mut self) {
        for link in self.links.values_mut() {
            // Of two at the same time the later counts.
            link.samples.reverse();
            link.samples.sort_by_key(|(stamp, _)| *stamp);
            link.samples.dedup_by_key(|(stamp, _)| *stamp);
        }
    }

    /// The frames from one up to that which is in no other; none twice.
    fn upwards<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        let (mut found, mut seen) = (vec![frame], HashSet::from([frame]));
        while let Some(link) = found.last().and_then(|last| self.links.get(*last)) {
            if !seen.insert(&link.parent) {
                break;
            }
            found.push(&link.parent);
        }
        found
    }

    /// The way between two frames. Motion is measured in `fixed`, or in `odom` if both are in it, or else in the
    /// topmost frame.
    ///
    /// # Errors
    /// No transforms lead from one to the other, or not over `fixed`.
    pub fn route(&self, from: &str, to: &str, fixed: Option<&str>) -> Result<Route> {
        let ends = [self.upwards(from), self.upwards(to)];
        let shared = |frame: &str| ends.iter().all(|end| end.contains(&frame));
        let Some(&first) = ends[0].iter().find(|frame| shared(frame)) else {
            let known: Vec<&str> = self.links.keys().map(String::as_str).collect();
            let what = format!("no transforms lead from `{from}` to `{to}`");
            return Err(Error::config(what).hint(if known.is_empty() {
                "the recording holds no transforms: record /tf and /tf_static, or give --camera FILE with the pose of \
                 the camera in the frame of the points"
                    .to_owned()
            } else {
                format!(
                    "those that are known place {}; give --tf with the topics of others, or --camera FILE with the \
                     pose of the camera in the frame of the points",
                    known.join(", ")
                )
            }));
        };
        let top = ends[0].last().copied().unwrap_or(first);
        let usual = if shared(CONTINUOUS) { CONTINUOUS } else { top };
        let fixed = fixed.unwrap_or(usual);
        if !shared(fixed) {
            let what = format!("`{from}` and `{to}` are not both in the frame `{fixed}`");
            let common: Vec<&str> = ends[0]
                .iter()
                .copied()
                .filter(|frame| shared(frame))
                .collect();
            return Err(Error::config(what).hint(format!("both are in {}", common.join(", "))));
        }
        let until = |end: &[&str], frame: &str| end.iter().position(|f| *f == frame).unwrap_or(0);
        let short = [until(&ends[0], first), until(&ends[1], first)];
        let ends = ends.map(|end| {
            let long = until(&end, fixed);
            end[..long]
                .iter()
                .map(|frame| (*frame).to_owned())
                .collect()
        });
        Ok(Route {
            ends,
            short,
            fixed: fixed.to_owned(),
        })
    }

    /// The motion that brings a point, in the first frame of a route at one time, into the last frame at another one.
    ///
    /// # Errors
    /// The place of a frame on the way is not known at its time.
    pub fn between(&self, route: &Route, times: [Stamp; 2]) -> std::result::Result<Rigid, Gap> {
        let up = |end: usize| {
            let frames = &route.ends[end];
            // At one time, what is above the first common frame cancels out.
            let count = if times[0] == times[1] {
                route.short[end].min(frames.len())
            } else {
                frames.len()
            };
            let mut rigid = Rigid::IDENTITY;
            for frame in &frames[..count] {
                rigid = self.place(frame, times[end])?.after(rigid);
            }
            Ok(rigid)
        };
        Ok(up(1)?.inverse().after(up(0)?))
    }

    /// Whether any frame on a route moves.
    pub fn move_on(&self, route: &Route) -> bool {
        let moves = |frame: &String| self.links.get(frame).is_some_and(|link| !link.is_static);
        route.ends.iter().flatten().any(moves)
    }

    /// Where a frame is in its parent at a time, between the transforms before and after it.
    fn place(&self, frame: &str, stamp: Stamp) -> std::result::Result<Rigid, Gap> {
        let Some(link) = self.links.get(frame) else {
            return Ok(Rigid::IDENTITY);
        };
        if let (true, Some((_, rigid))) = (link.is_static, link.samples.last()) {
            return Ok(*rigid);
        }
        let after = link.samples.partition_point(|(time, _)| *time < stamp);
        let next = link.samples.get(after);
        let before = after.checked_sub(1).map(|i| link.samples[i]);
        match (before, next) {
            (_, Some((time, rigid))) if *time == stamp => Ok(*rigid),
            (Some((start, a)), Some((end, b))) => {
                let share = (stamp - start) as f64 / (end - start) as f64;
                Ok(a.towards(*b, share))
            }
            (one, other) => {
                let nearest = one
                    .or(other.copied())
                    .map_or(0, |(time, _)| time.abs_diff(stamp));
                Err(Gap {
                    child: frame.to_owned(),
                    parent: link.parent.clone(),
                    away: format!("{:.3}", nearest as f64 * 1e-9),
                })
            }
        }
    }
}

impl Route {
    /// The frame that motion is measured in.
    pub fn fixed(&self) -> &str {
        &self.fixed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn add(tree: &mut Transforms, parent: &str, child: &str, stamp: Stamp, x: f64, fixed: bool) {
        let rigid = Rigid::new([0.0, 0.0, 0.0, 1.0], [x, 0.0, 0.0]).unwrap();
        let found = TransformStamped {
            stamp,
            parent: parent.to_owned(),
            child: child.to_owned(),
            rigid,
        };
        tree.add(found, fixed);
    }

    /// A car that drives at one unit of length a unit of time.
    fn car() -> Transforms {
        let mut tree = Transforms::default();
        for stamp in [20, 0, 10] {
            add(&mut tree, "odom", "base", stamp, stamp as f64, false);
        }
        add(&mut tree, "map", "odom", 0, 500.0, false);
        add(&mut tree, "base", "lidar", 0, 2.0, true);
        add(&mut tree, "base", "camera", 0, 3.0, true);
        tree.sort();
        tree
    }

    fn moved(tree: &Transforms, route: &Route, times: [Stamp; 2]) -> f64 {
        tree.between(route, times).unwrap().apply([0.0; 3])[0]
    }

    #[test]
    fn motion_between_two_times_is_taken_away() {
        let tree = car();
        let route = tree.route("lidar", "camera", None).unwrap();
        assert_eq!(route.fixed(), "odom");
        assert_eq!(moved(&tree, &route, [5, 5]), -1.0);
        // The camera looks later, when the car is three further.
        assert_eq!(moved(&tree, &route, [5, 8]), -4.0);
        let gap = tree.between(&route, [5, 21]).unwrap_err();
        assert!(
            gap.to_string().contains("`base` has no place in `odom`"),
            "{gap}"
        );
        // At one time the motion does not matter.
        assert_eq!(moved(&tree, &route, [30, 30]), -1.0);
        let route = tree.route("lidar", "camera", Some("base")).unwrap();
        assert_eq!(moved(&tree, &route, [5, 8]), -1.0);
    }

    #[test]
    fn frames_that_are_not_connected_are_named() {
        let mut tree = car();
        add(&mut tree, "world", "drone", 0, 0.0, true);
        for (from, to, fixed) in [
            ("drone", "camera", None),
            ("lidar", "camera", Some("earth")),
        ] {
            let error = tree.route(from, to, fixed).unwrap_err();
            assert!(error.to_string().contains(from), "{error}");
            assert!(error.advice().is_some());
        }
        // A frame is in itself, and circles end.
        assert_eq!(
            moved(&tree, &tree.route("x", "x", None).unwrap(), [1, 2]),
            0.0
        );
        add(&mut tree, "a", "b", 0, 0.0, true);
        add(&mut tree, "b", "a", 0, 0.0, true);
        assert!(tree.route("a", "camera", None).is_err());
    }

    #[test]
    fn another_parent_is_left_out_and_counted() {
        let mut tree = car();
        add(&mut tree, "trailer", "lidar", 0, 9.0, true);
        assert_eq!(tree.elsewhere, 1);
    }
}
