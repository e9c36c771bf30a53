//! Poses of frames of reference relative to each other at any time, like the buffer of tf2.

use crate::message::{Timestamp, TransformStamped};
use crate::rigid::Rigid;
use lsdc_files::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet, HashSet};

/// Frame in which robots measure their motion without jumps (ROS REP 105). If it exists, motion is measured in it.
const ODOMETRY: &str = "odom";

/// The transforms of a recording, or the last ones of a running robot.
#[derive(Clone, Debug, Default)]
pub struct Transforms {
    /// Links to the parents, by the child frame.
    links: BTreeMap<String, Link>,
    /// Number of transforms that were left out because their frame had another parent before.
    pub reparented: usize,
    /// Number of static transforms that replaced a different one.
    pub replaced: usize,
    /// Limits of the transforms that are kept, for a running robot.
    window: Option<Window>,
    /// Number of changes to the tree: new frames, and static transforms that differ.
    pub(crate) changes: usize,
    /// Number of frames whose stamps went back, after which their earlier transforms are dropped.
    pub(crate) jumps: usize,
    /// Number of transforms of frames beyond [`Window::FRAMES`], which are left out.
    pub(crate) crowded: usize,
}

/// Limits of the transforms that are kept for a running robot.
#[derive(Clone, Copy, Debug)]
struct Window {
    /// Duration before the newest transform of a frame, in nanoseconds.
    length: u64,
}

impl Window {
    /// Largest number of transforms of a frame: 2 kHz over 10 seconds.
    const SAMPLES: usize = 20_000;
    /// Largest number of frames with a parent: more than any robot has, few enough for malicious input.
    const FRAMES: usize = 1024;
    /// Stamps that go back by more nanoseconds mean that a clock was set back, or a recording was restarted. Smaller steps
    /// are messages out of order.
    const JUMP: i64 = 1_000_000_000;
}

/// The pose of a frame in its parent over time.
#[derive(Clone, Debug)]
struct Link {
    parent: String,
    is_static: bool,
    /// Poses over time, in order once sorted; of a static frame, only the last one received.
    samples: Vec<(Timestamp, Rigid)>,
    /// The latest stamp of the samples.
    newest: Timestamp,
    /// Longest time between two transforms over which motion is interpolated, in nanoseconds.
    max_gap: u64,
}

impl Link {
    /// Motion is interpolated across gaps up to this multiple of the usual interval: a few lost messages, not an outage of
    /// the odometry.
    const GAP_FACTOR: u64 = 5;
    /// Smallest limit, in nanoseconds. An acceleration of 3 m/s² over a quarter of a second deviates from a straight line
    /// by 2.3 cm (a t² / 8).
    const MIN_GAP: u64 = 250_000_000;
    /// Largest limit, in nanoseconds. The same acceleration over 2 seconds deviates by 1.5 m, so that motion between rarer
    /// poses is unknown.
    const MAX_GAP: u64 = 2_000_000_000;

    /// Returns the longest time between two transforms over which motion is interpolated, from the median interval.
    fn max_gap(samples: &[(Timestamp, Rigid)]) -> u64 {
        let times = samples.windows(2).map(|pair| pair[1].0.abs_diff(pair[0].0));
        let mut times: Vec<u64> = times.collect();
        let middle = times.len() / 2;
        if times.is_empty() {
            return Self::MIN_GAP;
        }
        let median = *times.select_nth_unstable(middle).1;
        median
            .saturating_mul(Self::GAP_FACTOR)
            .clamp(Self::MIN_GAP, Self::MAX_GAP)
    }

    /// Drops transforms outside the window before one with this stamp is added. Returns whether the clock was set back.
    fn make_room(&mut self, stamp: Timestamp, window: Window) -> bool {
        let jumped = self.newest.saturating_sub(stamp) > Window::JUMP;
        if jumped {
            self.samples.clear();
            self.newest = stamp;
        }
        // The window may hold twice as many, so that the cost is amortised.
        let newest = self.newest.max(stamp);
        let first = self.samples.first().map_or(stamp, |(time, _)| *time);
        if self.samples.len() >= 2 * Window::SAMPLES || newest.abs_diff(first) > 2 * window.length {
            let oldest = newest.saturating_sub_unsigned(window.length);
            self.samples.retain(|(time, _)| *time >= oldest);
            let beyond = self.samples.len().saturating_sub(Window::SAMPLES);
            self.samples.drain(..beyond);
        }
        jumped
    }
}

/// The reason why the pose of a frame is unknown at a time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TransformGap {
    child: String,
    parent: String,
    /// Nanoseconds from the time to the nearest transform.
    distance: u64,
    /// Nanoseconds between the transforms before and after the time, and the limit; `None` if it is before the first or
    /// after the last transform.
    between: Option<(u64, u64)>,
}

impl TransformGap {
    /// Returns the kind of gap, for counting.
    pub fn kind(&self) -> &'static str {
        match self.between {
            None => "without transforms at their time",
            Some(_) => "in a gap between transforms",
        }
    }
}

impl std::fmt::Display for TransformGap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            child,
            parent,
            distance,
            between,
        } = self;
        let seconds = |nanoseconds: &u64| *nanoseconds as f64 * 1e-9;
        write!(
            f,
            "`{child}` has no place in `{parent}` at its time, the nearest is {:.3} s away",
            seconds(distance)
        )?;
        match between {
            None => Ok(()),
            Some((interval, max_gap)) => write!(
                f,
                ", in a gap of {:.3} s: motion is interpolated over {:.3} s at most",
                seconds(interval),
                seconds(max_gap)
            ),
        }
    }
}

/// The route from one frame to another, over a common ancestor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    /// The frames from each end up to, but excluding, the one in which motion is measured.
    ends: [Vec<String>; 2],
    /// How many of them lead to the first common ancestor: sufficient if both times are equal.
    short: [usize; 2],
    /// Frame in which motion is measured.
    fixed: String,
}

impl Transforms {
    /// Creates a buffer for a running robot: for each frame, transforms older than its newest by `length` nanoseconds are
    /// dropped.
    pub(crate) fn of_the_last(length: u64) -> Self {
        Self {
            window: Some(Window { length }),
            ..Self::default()
        }
    }

    /// Adds a transform. A static one is valid at all times.
    pub fn add(&mut self, found: TransformStamped, is_static: bool) {
        if self.window.is_some()
            && self.links.len() >= Window::FRAMES
            && !self.links.contains_key(&found.child)
        {
            self.crowded += 1;
            return;
        }
        let changes = &mut self.changes;
        let link = self.links.entry(found.child).or_insert_with(|| {
            *changes += 1;
            Link {
                parent: found.parent.clone(),
                is_static,
                samples: Vec::new(),
                newest: found.stamp,
                max_gap: 0,
            }
        });
        if link.parent != found.parent {
            self.reparented += 1;
            return;
        }
        self.changes += usize::from(is_static && !link.is_static);
        link.is_static |= is_static;
        if link.is_static {
            let differs = |(_, last): &(Timestamp, Rigid)| *last != found.rigid;
            let replaced = usize::from(link.samples.last().is_some_and(differs));
            self.replaced += replaced;
            self.changes += replaced;
            link.samples.clear();
        } else if let Some(window) = self.window {
            self.jumps += usize::from(link.make_room(found.stamp, window));
        }
        link.newest = link.newest.max(found.stamp);
        link.samples.push((found.stamp, found.rigid));
    }

    /// Drops the frames that move, for a clock that was set back.
    pub(crate) fn forget_motion(&mut self) {
        self.links.retain(|_, link| link.is_static);
        self.changes += 1;
    }

    /// Returns only the transforms of the frames on a route, ready for [`Self::between`].
    pub(crate) fn along(&self, route: &Route) -> Self {
        let frames = route.ends.iter().flatten();
        let links =
            frames.filter_map(|frame| Some((frame.clone(), self.links.get(frame)?.clone())));
        let mut found = Self {
            links: links.collect(),
            ..Self::default()
        };
        found.sort();
        found
    }

    /// Whether all moving frames on a route have transforms at or after their times.
    pub(crate) fn reach(&self, route: &Route, times: [Timestamp; 2]) -> bool {
        let same = times[0] == times[1];
        (0..2).all(|end| {
            route.measured(end, same).iter().all(|frame| {
                let link = self.links.get(frame);
                link.is_none_or(|link| link.is_static || link.newest >= times[end])
            })
        })
    }

    /// Prepares for [`Self::between`], after all transforms were added.
    pub fn sort(&mut self) {
        for link in self.links.values_mut() {
            // Of two at the same time the later one received is kept.
            link.samples.reverse();
            link.samples.sort_by_key(|(stamp, _)| *stamp);
            link.samples.dedup_by_key(|(stamp, _)| *stamp);
            link.max_gap = Link::max_gap(&link.samples);
        }
    }

    /// Returns all frames, parents and children.
    pub fn frames(&self) -> impl Iterator<Item = &str> {
        let parents = self.links.values().map(|link| link.parent.as_str());
        let children = self.links.keys().map(String::as_str);
        let all: BTreeSet<&str> = children.chain(parents).collect();
        all.into_iter()
    }

    /// Returns a frame and its ancestors up to the root; cycles end at the first repetition.
    fn ancestors<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        let (mut found, mut seen) = (vec![frame], HashSet::from([frame]));
        while let Some(link) = found.last().and_then(|last| self.links.get(*last)) {
            if !seen.insert(&link.parent) {
                break;
            }
            found.push(&link.parent);
        }
        found
    }

    /// Returns the route between two frames. Motion is measured in `fixed`, or by default in `odom` if it is a common
    /// ancestor, else in the root.
    ///
    /// # Errors
    /// No transforms connect the frames, or not over `fixed`.
    pub fn route(&self, from: &str, to: &str, fixed: Option<&str>) -> Result<Route> {
        let ends = [self.ancestors(from), self.ancestors(to)];
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
        let default_frame = if shared(ODOMETRY) { ODOMETRY } else { top };
        let fixed = fixed.unwrap_or(default_frame);
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

    /// Returns the transform from the first frame of a route at one time to the last frame at another.
    ///
    /// # Errors
    /// The pose of a frame on the route is unknown at its time.
    pub fn between(
        &self,
        route: &Route,
        times: [Timestamp; 2],
    ) -> std::result::Result<Rigid, TransformGap> {
        let up = |end: usize| {
            let mut rigid = Rigid::IDENTITY;
            for frame in route.measured(end, times[0] == times[1]) {
                rigid = self.pose_at(frame, times[end])?.after(rigid);
            }
            Ok(rigid)
        };
        Ok(up(1)?.inverse().after(up(0)?))
    }

    /// Whether any frame on a route moves.
    pub fn is_dynamic(&self, route: &Route) -> bool {
        let moves = |frame: &String| self.links.get(frame).is_some_and(|link| !link.is_static);
        route.ends.iter().flatten().any(moves)
    }

    /// Returns the pose of a frame in its parent at a time, interpolated between the transforms before and after it.
    fn pose_at(&self, frame: &str, stamp: Timestamp) -> std::result::Result<Rigid, TransformGap> {
        let Some(link) = self.links.get(frame) else {
            return Ok(Rigid::IDENTITY);
        };
        if let (true, Some((_, rigid))) = (link.is_static, link.samples.last()) {
            return Ok(*rigid);
        }
        let gap = |distance, between| TransformGap {
            child: frame.to_owned(),
            parent: link.parent.clone(),
            distance,
            between,
        };
        let after = link.samples.partition_point(|(time, _)| *time < stamp);
        let next = link.samples.get(after);
        let before = after.checked_sub(1).map(|i| link.samples[i]);
        match (before, next) {
            (_, Some((time, rigid))) if *time == stamp => Ok(*rigid),
            (Some((start, a)), Some((end, b))) => {
                let (interval, elapsed) = (end.abs_diff(start), stamp.abs_diff(start));
                // Equal poses mean that the frame has not moved, however long the interval.
                if interval > link.max_gap && a != *b {
                    let distance = elapsed.min(interval - elapsed);
                    return Err(gap(distance, Some((interval, link.max_gap))));
                }
                Ok(a.interpolate(*b, elapsed as f64 / interval as f64))
            }
            (one, other) => {
                let nearest = one.or(other.copied());
                let distance = nearest.map_or(0, |(time, _)| time.abs_diff(stamp));
                Err(gap(distance, None))
            }
        }
    }
}

impl Route {
    /// Returns the frame in which motion is measured.
    pub fn fixed(&self) -> &str {
        &self.fixed
    }

    /// Returns the frames from an end whose poses matter. If both times are equal, the poses above the first common
    /// ancestor cancel out.
    fn measured(&self, end: usize, at_one_time: bool) -> &[String] {
        let frames = &self.ends[end];
        let count = if at_one_time {
            self.short[end].min(frames.len())
        } else {
            frames.len()
        };
        &frames[..count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn add(
        tree: &mut Transforms,
        parent: &str,
        child: &str,
        stamp: Timestamp,
        x: f64,
        fixed: bool,
    ) {
        let rigid = Rigid::new([0.0, 0.0, 0.0, 1.0], [x, 0.0, 0.0]).unwrap();
        let found = TransformStamped {
            stamp,
            parent: parent.to_owned(),
            child: child.to_owned(),
            rigid,
        };
        tree.add(found, fixed);
    }

    /// A car that moves by one unit of length per unit of time.
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

    fn moved(tree: &Transforms, route: &Route, times: [Timestamp; 2]) -> f64 {
        tree.between(route, times).unwrap().apply([0.0; 3])[0]
    }

    #[test]
    fn motion_between_two_times_is_taken_away() {
        let tree = car();
        let route = tree.route("lidar", "camera", None).unwrap();
        assert_eq!(route.fixed(), "odom");
        assert_eq!(moved(&tree, &route, [5, 5]), -1.0);
        // The image is taken later, when the car is three units further.
        assert_eq!(moved(&tree, &route, [5, 8]), -4.0);
        let gap = tree.between(&route, [5, 21]).unwrap_err();
        assert!(
            gap.to_string().contains("`base` has no place in `odom`"),
            "{gap}"
        );
        // If both times are equal, the motion does not matter.
        assert_eq!(moved(&tree, &route, [30, 30]), -1.0);
        let route = tree.route("lidar", "camera", Some("base")).unwrap();
        assert_eq!(moved(&tree, &route, [5, 8]), -1.0);
    }

    /// 50 Hz with an outage of 30 s: times near its ends are rejected as those in its middle.
    #[test]
    fn motion_is_not_interpolated_over_an_outage() {
        const SECOND: Timestamp = 1_000_000_000;
        let tree = |stamps: &mut dyn Iterator<Item = Timestamp>| {
            let mut tree = Transforms::default();
            for stamp in stamps {
                add(&mut tree, "odom", "base", stamp, stamp as f64 * 1e-9, false);
            }
            tree.sort();
            tree
        };
        let driven = tree(&mut (0..100).chain(1600..1700).map(|step| step * SECOND / 50));
        let at = |tree: &Transforms, seconds: f64| {
            let stamp = (seconds * 1e9) as Timestamp;
            let route = tree.route("base", "odom", Some("odom")).unwrap();
            let found = tree.between(&route, [stamp, 0]);
            found.map(|moved| moved.apply([0.0; 3])[0])
        };
        assert!((at(&driven, 1.01).unwrap() - 1.01).abs() < 1e-9);
        for seconds in [1.99, 17.0, 31.9] {
            let gap = at(&driven, seconds).unwrap_err();
            assert_eq!(gap.kind(), "in a gap between transforms", "{gap}");
            assert!(gap.to_string().contains("in a gap of 30.020 s"), "{gap}");
            assert!(gap.to_string().contains("over 0.250 s"), "{gap}");
        }
        assert_eq!(
            at(&driven, 34.1).unwrap_err().kind(),
            "without transforms at their time"
        );
        // Four lost messages are bridged, and so is a rate of 1 Hz.
        let mut lost = (0..10).chain(14..30).map(|step| step * SECOND / 20);
        assert!(at(&tree(&mut lost), 0.58).is_ok());
        assert!(at(&tree(&mut (0..10).map(|step| step * SECOND)), 4.5).is_ok());
        // Two poses with nothing in between are an outage, unless they are equal.
        assert!(at(&tree(&mut [0, 30 * SECOND].into_iter()), 15.0).is_err());
        let mut still = Transforms::default();
        for stamp in [0, 30 * SECOND] {
            add(&mut still, "odom", "base", stamp, 7.0, false);
        }
        still.sort();
        assert_eq!(at(&still, 15.0).unwrap(), 7.0);
        // The largest possible interval.
        let ends = tree(&mut [Timestamp::MIN, Timestamp::MAX].into_iter());
        assert!(at(&ends, 1.0).is_err());
    }

    #[test]
    fn static_transforms_that_change_are_counted() {
        let mut tree = car();
        add(&mut tree, "base", "lidar", 5, 2.0, true);
        assert_eq!(tree.replaced, 0);
        add(&mut tree, "base", "lidar", 5, 2.5, true);
        assert_eq!(tree.replaced, 1);
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
        // A frame is its own ancestor, and cycles end.
        assert_eq!(
            moved(&tree, &tree.route("x", "x", None).unwrap(), [1, 2]),
            0.0
        );
        add(&mut tree, "a", "b", 0, 0.0, true);
        add(&mut tree, "b", "a", 0, 0.0, true);
        assert!(tree.route("a", "camera", None).is_err());
    }

    /// The window of a running robot, and a clock that is set back.
    #[test]
    fn a_window_forgets_what_is_old() {
        const SECOND: Timestamp = 1_000_000_000;
        let mut tree = Transforms::of_the_last(10 * SECOND as u64);
        add(&mut tree, "base", "camera", 0, 3.0, true);
        let drive = |tree: &mut Transforms, steps: std::ops::Range<i64>| {
            for step in steps {
                let stamp = step * SECOND / 20;
                add(tree, "odom", "base", stamp, step as f64, false);
            }
        };
        drive(&mut tree, 0..2000);
        let count = tree.links["base"].samples.len();
        assert!((200..=420).contains(&count), "{count}");
        let route = tree.route("base", "camera", Some("odom")).unwrap();
        let at = |seconds: i64| [seconds * SECOND, seconds * SECOND + SECOND / 10];
        let some = tree.along(&route);
        assert_eq!(moved(&some, &route, at(95)), -2.0 - 3.0);
        assert!(some.between(&route, at(40)).is_err());
        assert!(tree.reach(&route, at(99)) && !tree.reach(&route, at(100)));
        assert!(tree.reach(&route, [at(200)[0]; 2]), "one time");
        // A transform that is late by less than a second is added; an earlier one clears the window.
        add(&mut tree, "odom", "base", 99 * SECOND + 1, 0.0, false);
        assert_eq!((tree.jumps, tree.reach(&route, at(99))), (0, true));
        drive(&mut tree, 100..200);
        assert_eq!((tree.jumps, tree.reach(&route, at(99))), (1, false));
        assert_eq!(moved(&tree.along(&route), &route, at(6)), -2.0 - 3.0);
        tree.forget_motion();
        assert!(tree.route("base", "camera", Some("odom")).is_err());
    }

    #[test]
    fn frames_without_number_are_refused() {
        let mut tree = Transforms::of_the_last(1);
        for number in 0..2 * Window::FRAMES {
            add(
                &mut tree,
                "odom",
                &number.to_string(),
                0,
                0.0,
                number % 2 == 0,
            );
        }
        assert_eq!(
            (tree.links.len(), tree.crowded),
            (Window::FRAMES, Window::FRAMES)
        );
    }

    #[test]
    fn another_parent_is_left_out_and_counted() {
        let mut tree = car();
        add(&mut tree, "trailer", "lidar", 0, 9.0, true);
        assert_eq!(tree.reparented, 1);
    }
}
