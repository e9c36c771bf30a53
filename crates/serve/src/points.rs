//! Points as JSON: `[[u, v, depth], [u, v, depth, sigma], ...]`, alone or with options.

use crate::fault::Fault;
use crate::options::Options;
use lsdc_core::{Observation, Observations};
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use std::cell::Cell;
use std::fmt::Formatter;

/// Reads a list of points, in the order given.
///
/// # Errors
/// No JSON, or something else than points; more than `max_points`, of which no more are kept in memory.
pub(crate) fn parse(json: &[u8], max_points: usize) -> Result<Observations, Fault> {
    let limit = Limit::new(max_points);
    let found = deserialize_all(json, PointList(&limit));
    found.map_err(|error| {
        limit.fault(|| {
            Fault::malformed(format!("the points cannot be read: {error}"))
                .hint("points are [[u, v, depth], [u, v, depth, sigma], ...]")
        })
    })
}

/// Reads `{"points": [...], "options": {...}}`, as a request to a scene has it.
///
/// # Errors
/// As for [`parse`]; unknown or wrong options.
pub(crate) fn parse_with_options(
    json: &[u8],
    max_points: usize,
) -> Result<(Observations, Options), Fault> {
    let limit = Limit::new(max_points);
    let found = deserialize_all(json, PointsAndOptions(&limit));
    let (points, options) = found.map_err(|error| {
        limit.fault(|| {
            Fault::malformed(format!("the request cannot be read: {error}"))
                .hint("it is {\"points\": [[u, v, depth], ...], \"options\": {...}}")
        })
    })?;
    Ok((points, options.checked()?))
}

fn deserialize_all<'de, S: DeserializeSeed<'de>>(
    json: &'de [u8],
    seed: S,
) -> serde_json::Result<S::Value> {
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    let found = seed.deserialize(&mut deserializer)?;
    deserializer.end()?;
    Ok(found)
}

/// Number of points taken, and whether there were more.
struct Limit {
    max_points: usize,
    exceeded: Cell<bool>,
}

impl Limit {
    fn new(max_points: usize) -> Self {
        let exceeded = Cell::new(false);
        Self {
            max_points,
            exceeded,
        }
    }

    fn fault(&self, otherwise: impl FnOnce() -> Fault) -> Fault {
        if self.exceeded.get() {
            too_many(self.max_points)
        } else {
            otherwise()
        }
    }
}

/// The fault of more points than are taken.
pub(crate) fn too_many(max_points: usize) -> Fault {
    Fault::too_large(format!("there are more than {max_points} points")).hint("send a part of them")
}

/// A point: three numbers, and an optional fourth, which may be null.
struct Point(Observation);

impl<'de> Deserialize<'de> for Point {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Numbers;
        impl<'de> Visitor<'de> for Numbers {
            type Value = Point;

            fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
                write!(f, "a point: [u, v, depth] or [u, v, depth, sigma]")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut row: A) -> Result<Point, A::Error> {
                let short = |count| A::Error::invalid_length(count, &self);
                let u = row.next_element()?.ok_or_else(|| short(0))?;
                let v = row.next_element()?.ok_or_else(|| short(1))?;
                let depth = row.next_element()?.ok_or_else(|| short(2))?;
                let sigma = row.next_element::<Option<f32>>()?.flatten();
                if row.next_element::<serde::de::IgnoredAny>()?.is_some() {
                    return Err(short(5));
                }
                Ok(Point(Observation { u, v, depth, sigma }))
            }
        }
        deserializer.deserialize_seq(Numbers)
    }
}

/// A list of points, which is read no further than the limit.
struct PointList<'a>(&'a Limit);

impl<'de> DeserializeSeed<'de> for PointList<'_> {
    type Value = Observations;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for PointList<'_> {
    type Value = Observations;

    fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "a list of points")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut points = Observations::new();
        while let Some(Point(point)) = list.next_element()? {
            if points.len() == self.0.max_points {
                self.0.exceeded.set(true);
                return Err(A::Error::custom("too many points"));
            }
            points.push(point);
        }
        Ok(points)
    }
}

/// Points with options.
struct PointsAndOptions<'a>(&'a Limit);

#[derive(Deserialize)]
#[serde(field_identifier, rename_all = "lowercase")]
enum Key {
    Points,
    Options,
}

impl<'de> DeserializeSeed<'de> for PointsAndOptions<'_> {
    type Value = (Observations, Options);

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for PointsAndOptions<'_> {
    type Value = (Observations, Options);

    fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "an object with points, and perhaps options")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut points, mut options) = (None, None);
        while let Some(key) = map.next_key()? {
            match key {
                Key::Points if points.is_none() => {
                    points = Some(map.next_value_seed(PointList(self.0))?);
                }
                Key::Options if options.is_none() => options = Some(map.next_value()?),
                Key::Points => return Err(A::Error::duplicate_field("points")),
                Key::Options => return Err(A::Error::duplicate_field("options")),
            }
        }
        let points = points.ok_or_else(|| A::Error::missing_field("points"))?;
        Ok((points, options.unwrap_or_default()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::FaultKind;

    #[test]
    fn a_fourth_number_is_a_standard_deviation() {
        let points = parse(b"[[1, 2.5, 3], [4,5,6,0.5], [7,8,9,null]]", 3).unwrap();
        let sigmas: Vec<_> = points.iter().map(|point| point.sigma).collect();
        assert_eq!(sigmas, [None, Some(0.5), None]);
        assert_eq!(points.as_slice()[0].v, 2.5);
    }

    #[test]
    fn what_is_no_list_of_points_is_refused() {
        for json in [
            "",
            "{}",
            "[1,2,3]",
            "[[1,2]]",
            "[[1,2,3,4,5]]",
            "[[1,2,\"3\"]]",
            "[[1,2,3]",
            "[[1,2,NaN]]",
            "[[[1],2,3]]",
            "[[1,2,3]] x",
        ] {
            let fault = parse(json.as_bytes(), 9).unwrap_err();
            assert_eq!(fault.kind, FaultKind::Malformed, "{json}");
        }
    }

    #[test]
    fn a_list_is_read_no_further_than_the_limit() {
        // The rest is not JSON, which goes unnoticed.
        for json in ["[[1,2,3],[1,2,3]]", "[[1,2,3],[1,2,3] no JSON"] {
            assert_eq!(
                parse(json.as_bytes(), 1).unwrap_err().kind,
                FaultKind::TooLarge
            );
            let request = format!("{{\"points\": {json}}}");
            let fault = parse_with_options(request.as_bytes(), 1).unwrap_err();
            assert_eq!(fault.kind, FaultKind::TooLarge);
        }
        assert_eq!(parse(b"[[1,2,3],[1,2,3]]", 2).unwrap().len(), 2);
    }

    #[test]
    fn a_request_has_points_and_perhaps_options() {
        let read = |json: &str| parse_with_options(json.as_bytes(), 9);
        let (points, options) =
            read(r#"{"options": {"sigma": 0.5}, "points": [[1,2,3]]}"#).unwrap();
        assert_eq!((points.len(), options.sigma), (1, Some(0.5)));
        assert_eq!(read(r#"{"points": []}"#).unwrap().1, Options::default());
        for (json, kind) in [
            ("[]", FaultKind::Malformed),
            ("{}", FaultKind::Malformed),
            (r#"{"points": [], "points": []}"#, FaultKind::Malformed),
            (r#"{"points": [], "colour": 1}"#, FaultKind::Malformed),
            (
                r#"{"points": [], "options": {"colour": 1}}"#,
                FaultKind::Malformed,
            ),
            (
                r#"{"points": [], "options": {"sigma": -1}}"#,
                FaultKind::Unusable,
            ),
        ] {
            assert_eq!(read(json).unwrap_err().kind, kind, "{json}");
        }
    }
}
