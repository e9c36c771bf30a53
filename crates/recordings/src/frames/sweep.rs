//! Motion compensation within a sweep of a scanner: each point at its own time.

use crate::message::{PointCloud, Timestamp};
use crate::rigid::Rigid;
use crate::transforms::{Route, Transforms};

/// The field of clouds that contains the time of each point.
#[derive(Clone, Debug, PartialEq)]
pub struct PointTimes {
    /// Name of the field.
    pub field: String,
    /// Longest duration of a cloud among the first clouds, from the first point to the last, in seconds.
    pub seconds: f64,
    /// Type of the field.
    kind: u8,
    clock: Clock,
}

/// The unit and the origin of times.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Clock {
    /// Nanoseconds per unit.
    unit: f64,
    /// Whether times count from 1970 rather than from the stamp of the cloud.
    absolute: bool,
}

impl Clock {
    /// All candidates. For integers only the last one is tried.
    const ALL: [Self; 8] = [
        Self::new(1e9, false),
        Self::new(1e9, true),
        Self::new(1.0, true),
        Self::new(1e3, true),
        Self::new(1e6, true),
        Self::new(1e6, false),
        Self::new(1e3, false),
        Self::new(1.0, false),
    ];
    /// Index of the first guessed candidate: small numbers fit any small unit.
    const GUESSED: usize = 5;
    const WHOLE: usize = Self::ALL.len() - 1;

    const fn new(unit: f64, absolute: bool) -> Self {
        Self { unit, absolute }
    }

    /// Returns the nanoseconds from a stamp to a time, if they are close: within a second for times since 1970; otherwise
    /// within the slowest turn (a fifth of a second, with some margin), as small numbers may count from another origin.
    fn from(self, stamp: Timestamp, time: f64) -> Option<i64> {
        let (zero, near) = if self.absolute {
            (stamp, 1_000_000_000)
        } else {
            (0, 250_000_000)
        };
        // The cast saturates.
        let offset = ((time * self.unit).round() as i64).saturating_sub(zero);
        (time.is_finite() && offset.unsigned_abs() <= near).then_some(offset)
    }
}

/// Detects the clock of point times by trying every clock on the first clouds of a recording.
#[derive(Clone, Debug, Default)]
pub(super) struct ClockDetector {
    /// Time field of the first cloud that has one, and its type.
    field: Option<(String, u8)>,
    /// Number of clouds with this field.
    clouds: usize,
    /// For each clock, the number of clouds that fit it and the longest of their durations, in nanoseconds.
    fits: [(usize, i64); Clock::ALL.len()],
}

impl ClockDetector {
    /// Number of clouds to examine. The first clouds of a recording may be partial turns, and simulated time starts at 0.
    const CLOUDS: usize = 50;

    /// Whether enough clouds were examined.
    pub(super) fn is_done(&self) -> bool {
        self.clouds == Self::CLOUDS
    }

    /// Examines a cloud, unless enough were examined.
    pub(super) fn add(&mut self, points: &PointCloud<'_>, stamp: Timestamp) {
        let Some((name, kind)) = points.time_field() else {
            return;
        };
        let (first, same) = self.field.get_or_insert_with(|| (name.to_owned(), kind));
        if self.clouds == Self::CLOUDS || (first.as_str(), *same) != (name, kind) {
            return;
        }
        self.clouds += 1;
        let whole = points.has_whole_times();
        for (at, clock) in Clock::ALL.into_iter().enumerate() {
            if whole && at < Clock::WHOLE {
                continue;
            }
            let Some([first, last]) = span(points, stamp, clock) else {
                continue;
            };
            // This rules out seconds since a scanner was switched on, which could otherwise be milliseconds.
            let touches = first.max(-last) <= last - first;
            if touches || whole || at < Clock::GUESSED {
                let (clouds, longest) = &mut self.fits[at];
                *clouds += 1;
                *longest = (last - first).max(*longest);
            }
        }
    }

    /// Returns the clock that at least half of the clouds fit: among those that are not guesses the one with most clouds,
    /// else the first of the guesses.
    ///
    /// # Errors
    /// Times exist but fit no clock: the name of the field, and the number of clouds that were tried.
    pub(super) fn found(&self) -> Result<Option<PointTimes>, (String, usize)> {
        let Some((field, kind)) = self.field.clone() else {
            return Ok(None);
        };
        let enough = |at: &usize| 2 * self.fits[*at].0 >= self.clouds;
        // On ties `max_by_key` returns the last.
        let known = (0..Clock::GUESSED).rev().max_by_key(|at| self.fits[*at].0);
        let mut any = known.into_iter().chain(Clock::GUESSED..Clock::ALL.len());
        let Some(at) = any.find(enough) else {
            return Err((field, self.clouds));
        };
        Ok(Some(PointTimes {
            field,
            seconds: self.fits[at].1 as f64 * 1e-9,
            kind,
            clock: Clock::ALL[at],
        }))
    }
}

/// Returns the first and the last time of a cloud that are close to its stamp by a clock, in nanoseconds from the stamp;
/// `None` if less than half of the times are close or all points have the same time.
fn span(points: &PointCloud<'_>, stamp: Timestamp, clock: Clock) -> Option<[i64; 2]> {
    let (mut all, mut near) = (0_usize, 0);
    let mut ends: Option<[i64; 2]> = None;
    for (position, time) in points.timed()? {
        // Points without a return may lack a time.
        if position.iter().any(|v| !v.is_finite()) {
            continue;
        }
        all += 1;
        if let Some(offset) = clock.from(stamp, time) {
            near += 1;
            let [first, last] = ends.unwrap_or([offset; 2]);
            ends = Some([first.min(offset), last.max(offset)]);
        }
    }
    ends.filter(|[first, last]| first < last && 2 * near >= all)
}

/// The times of a cloud's points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sweep {
    /// Stamp of the cloud.
    stamp: Timestamp,
    clock: Clock,
    /// Times of the first and the last point, relative to the stamp.
    ends: [i64; 2],
}

impl Sweep {
    /// Returns the sweep of a cloud whose time field is that of the first clouds of the recording.
    pub(super) fn of(
        points: &PointCloud<'_>,
        stamp: Timestamp,
        found: &PointTimes,
    ) -> Option<Self> {
        let PointTimes {
            field, kind, clock, ..
        } = found;
        let same = points.time_field() == Some((field.as_str(), *kind));
        let ends = span(points, stamp, *clock).filter(|_| same)?;
        Some(Self {
            stamp,
            clock: *clock,
            ends,
        })
    }

    /// Returns the time of its last point.
    pub(super) fn end(self) -> Timestamp {
        self.stamp.saturating_add(self.ends[1])
    }

    /// Returns the transforms from its points to the pose of the camera at the time `seen`.
    pub(super) fn motions<'a>(
        self,
        transforms: &'a Transforms,
        route: &'a Route,
        seen: Timestamp,
    ) -> PointMotions<'a> {
        let [first, last] = self.ends;
        let count = (last - first) / PointMotions::STEP + 2;
        let mut motions = PointMotions {
            sweep: self,
            transforms,
            route,
            seen,
            edges: Vec::new(),
        };
        let edges = (0..count).map(|edge| motions.exact(first + edge * PointMotions::STEP));
        motions.edges = edges.collect();
        motions
    }
}

/// Transform of each point of a cloud, by its time.
pub(super) struct PointMotions<'a> {
    sweep: Sweep,
    transforms: &'a Transforms,
    route: &'a Route,
    seen: Timestamp,
    /// Transforms at regular times from the first point to beyond the last, where known.
    pub(super) edges: Vec<Option<Rigid>>,
}

impl PointMotions<'_> {
    /// Nanoseconds between edges. Motion is interpolated linearly between them, as between transforms, which are further
    /// apart.
    const STEP: i64 = 1_000_000;

    /// Computes the transform at an offset from the stamp of the cloud, in nanoseconds.
    fn exact(&self, offset: i64) -> Option<Rigid> {
        let time = self.sweep.stamp.saturating_add(offset);
        self.transforms.between(self.route, [time, self.seen]).ok()
    }

    /// Returns the transform of a point with this time, if it is close to the stamp and covered by transforms.
    pub(super) fn at(&self, time: f64) -> Option<Rigid> {
        let offset = self.sweep.clock.from(self.sweep.stamp, time)?;
        let past = offset - self.sweep.ends[0];
        let edge = usize::try_from(past.div_euclid(Self::STEP)).ok();
        let edges = edge.and_then(|edge| self.edges.get(edge..edge + 2));
        if let Some([Some(before), Some(after)]) = edges {
            let share = past.rem_euclid(Self::STEP) as f64 / Self::STEP as f64;
            return Some(before.interpolate(*after, share));
        }
        self.exact(offset)
    }
}

/// For fuzzers and tests: counts the points of a cloud whose time would be used to move them.
pub(crate) fn timed(points: &PointCloud<'_>, stamp: Timestamp) -> usize {
    let mut detector = ClockDetector::default();
    detector.add(points, stamp);
    let still = Transforms::default();
    let (Ok(Some(found)), Ok(route)) = (detector.found(), still.route("", "", None)) else {
        return 0;
    };
    let (Some(sweep), Some(times)) = (Sweep::of(points, stamp, &found), points.timed()) else {
        return 0;
    };
    let motions = sweep.motions(&still, &route, stamp);
    times
        .filter(|(_, time)| motions.at(*time).is_some())
        .count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cdr::CdrWriter;
    use crate::message::Header;

    const STAMP: Timestamp = 1_700_000_000_250_000_000;

    /// A cloud with a time for each point, in a field of this name and type; points without a return have no time.
    fn cloud(name: &str, kind: u8, times: &[f64]) -> Vec<u8> {
        let mut writer = CdrWriter::with_capacity(0);
        Header::default().write(&mut writer);
        writer.u32(1);
        writer.u32(times.len() as u32 + 1);
        writer.u32(4);
        for (name, offset, kind) in [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), (name, 12, kind)] {
            writer.string(name);
            writer.u32(offset);
            writer.u8(kind);
            writer.u32(1);
        }
        writer.u8(0);
        writer.u32(20);
        writer.u32(20 * (times.len() as u32 + 1));
        let mut data = Vec::new();
        for &time in times {
            data.extend([1.0_f32; 3].into_iter().flat_map(f32::to_le_bytes));
            let (wide, narrow) = (time.to_le_bytes(), (time as f32).to_le_bytes());
            let (signed, whole) = ((time as i32).to_le_bytes(), (time as u32).to_le_bytes());
            match kind {
                8 => data.extend(wide),
                7 => data.extend([narrow, [0; 4]].concat()),
                5 => data.extend([signed, [0; 4]].concat()),
                _ => data.extend([whole, [0; 4]].concat()),
            }
        }
        data.extend([0; 20]);
        writer.bytes(data.into_iter());
        writer.finish()
    }

    /// Runs the detector on these clouds.
    fn tried(clouds: &[(Vec<u8>, Timestamp)]) -> Result<Option<PointTimes>, (String, usize)> {
        let mut detector = ClockDetector::default();
        for (message, stamp) in clouds {
            detector.add(&PointCloud::of(message).unwrap(), *stamp);
        }
        detector.found()
    }

    fn sweep(message: &[u8], stamp: Timestamp, found: &PointTimes) -> Option<Sweep> {
        Sweep::of(&PointCloud::of(message).unwrap(), stamp, found)
    }

    /// Times as the drivers of scanners write them.
    #[test]
    fn times_of_all_drivers_are_understood() {
        let seconds = STAMP as f64 * 1e-9;
        for (name, kind, times, ends) in [
            // Ouster; Nebula.
            ("t", 6, [0.0, 99_900_000.0], [0, 99_900_000]),
            ("time_stamp", 6, [500.0, 99_900_000.0], [500, 99_900_000]),
            // Velodyne, with the stamp of the first packet or of the last.
            ("time", 7, [0.0, 0.1], [0, 100_000_000]),
            ("time", 7, [-0.1, 0.0005], [-100_000_000, 500_000]),
            // Hesai and RoboSense; Livox.
            ("timestamp", 8, [seconds, seconds + 0.1], [0, 100_000_000]),
            ("timestamp", 8, [seconds - 0.1, seconds], [-100_000_000, 0]),
            (
                "timestamp",
                8,
                [seconds * 1e9, (seconds + 0.1) * 1e9],
                [0, 100_000_000],
            ),
            ("timestamp", 8, [0.0, 99_900_000.0], [0, 99_900_000]),
            // Converters.
            ("offset_time", 6, [0.0, 99_900_000.0], [0, 99_900_000]),
            (
                "time_offset",
                5,
                [-50_000_000.0, 49_900_000.0],
                [-50_000_000, 49_900_000],
            ),
            ("time", 7, [0.0, 99.9], [0, 99_900_000]),
            ("time", 7, [0.0, 99_900.0], [0, 99_900_000]),
        ] {
            let message = cloud(name, kind, &times);
            let found = tried(&[(message.clone(), STAMP)]).unwrap().unwrap();
            let sweep = sweep(&message, STAMP, &found).unwrap();
            // A double of nanoseconds since 1970 holds every 256th, one of seconds every 238th, a float seven digits.
            for (found, end) in sweep.ends.into_iter().zip(ends) {
                assert!(
                    (found - end).abs() <= 512,
                    "{name} {times:?}: {found} {end}"
                );
            }
            let long = (ends[1] - ends[0]) as f64 * 1e-9;
            assert!((found.seconds - long).abs() < 1.1e-6 && found.field == name);
        }
    }

    #[test]
    fn what_is_no_time_near_the_stamp_is_none() {
        for (name, kind, times) in [
            ("t", 6, [0.0, 2e9]),
            ("t", 6, [9e8, 9.5e8]),
            ("time", 7, [5e9, 6e9]),
            ("timestamp", 8, [500.0, 500.1]),
            ("timestamp", 8, [f64::NAN, f64::INFINITY]),
            ("timestamp", 8, [-1e300, 1e300]),
            ("timestamp", 8, [f64::MIN, f64::NEG_INFINITY]),
            ("time", 7, [0.0, 0.0]),
            ("t", 6, [0.0, 0.0]),
        ] {
            let message = cloud(name, kind, &times);
            for stamp in [STAMP, 0, i64::MIN, i64::MAX] {
                let clouds = [(message.clone(), stamp)];
                if stamp == STAMP {
                    assert_eq!(tried(&clouds), Err((name.to_owned(), 1)), "{times:?}");
                } else {
                    let _ = tried(&clouds);
                }
            }
        }
        // Not a time, by its name or by its type.
        for (name, kind) in [("ring", 7), ("t", 9), ("t", 0)] {
            let message = cloud(name, kind, &[0.0, 0.1]);
            assert_eq!(tried(&[(message, STAMP)]), Ok(None), "{name}");
        }
        assert_eq!(tried(&[]), Ok(None));
    }

    /// Simulated time starts at 0, so that absolute times could be relative to the stamp.
    #[test]
    fn most_clouds_say_what_times_count() {
        let tenth = |number: i64| 100_000_000 * number;
        let clouds = |since: bool| {
            let at = |number: i64| {
                let zero = if since { 0.1 * number as f64 } else { 0.0 };
                (cloud("timestamp", 8, &[zero, zero + 0.1]), tenth(number))
            };
            (0..20).map(at).collect::<Vec<_>>()
        };
        for since in [false, true] {
            let clouds = clouds(since);
            let found = tried(&clouds).unwrap().unwrap();
            assert_eq!(found.clock, Clock::new(1e9, since));
            let [(first, zero), .., (last, stamp)] = &clouds[..] else {
                panic!("no clouds")
            };
            for (message, stamp) in [(first, zero), (last, stamp)] {
                let sweep = sweep(message, *stamp, &found).unwrap();
                assert_eq!(sweep.ends, [0, 100_000_000]);
            }
        }
        // The first cloud is a small part of a turn, in milliseconds.
        let mut clouds = vec![(cloud("time", 7, &[0.0, 0.2]), STAMP)];
        let whole = |number| (cloud("time", 7, &[0.0, 100.0]), STAMP + tenth(number));
        clouds.extend((1..4).map(whole));
        let found = tried(&clouds).unwrap().unwrap();
        assert_eq!((found.clock, found.seconds), (Clock::new(1e6, false), 0.1));
    }

    /// A cloud of another type and one with invalid times are not deskewed.
    #[test]
    fn a_cloud_unlike_the_others_has_no_sweep() {
        let intact = cloud("t", 6, &[0.0, 1e8]);
        let found = tried(&[(intact.clone(), STAMP)]).unwrap().unwrap();
        assert!(sweep(&intact, STAMP, &found).is_some());
        for (name, kind, times) in [
            ("t", 7, [0.0, 0.1]),
            ("time", 6, [0.0, 1e8]),
            ("ring", 6, [0.0, 1e8]),
            ("t", 6, [0.0, 0.0]),
            ("t", 6, [4e9, 4e9 + 1e8]),
        ] {
            let message = cloud(name, kind, &times);
            assert_eq!(sweep(&message, STAMP, &found), None, "{name} {times:?}");
        }
        // One wrong time affects only one point.
        let message = cloud("t", 6, &[0.0, 5e7, 1e8, 3e9]);
        assert_eq!(
            sweep(&message, STAMP, &found).unwrap().ends,
            [0, 100_000_000]
        );
    }
}
