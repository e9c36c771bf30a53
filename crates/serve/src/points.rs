//! Points as JSON: `[[u, v, depth], [u, v, depth, sigma], ...]`.

use crate::fault::Fault;
use lsdc_core::{Observation, Observations};
use serde::Deserialize;
use serde::de::{Deserializer, Error, SeqAccess, Visitor};
use std::fmt::Formatter;

/// A list of points, in the order given.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Points(pub(crate) Observations);

impl Points {
    /// Reads a list.
    ///
    /// # Errors
    /// No JSON, or something else than points; more than `most` of them.
    pub(crate) fn parse(json: &[u8], most: usize) -> Result<Self, Fault> {
        let points: Self = serde_json::from_slice(json).map_err(|e| {
            Fault::malformed(format!("the points cannot be read: {e}"))
                .hint("points are [[u, v, depth], [u, v, depth, sigma], ...]")
        })?;
        points.checked(most)
    }

    pub(crate) fn checked(self, most: usize) -> Result<Self, Fault> {
        match self.0.len() {
            count if count > most => Err(too_many(count, most)),
            _ => Ok(self),
        }
    }
}

/// That there are more points than are taken.
pub(crate) fn too_many(count: usize, most: usize) -> Fault {
    Fault::too_large(format!(
        "{count} points are more than the {most} that are taken"
    ))
    .hint("send a part of them")
}

/// One point: three numbers, and a fourth that may be null.
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

impl<'de> Deserialize<'de> for Points {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let points = Vec::<Point>::deserialize(deserializer)?;
        Ok(Self(points.into_iter().map(|point| point.0).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::Kind;

    #[test]
    fn a_fourth_number_is_a_standard_deviation() {
        let points = Points::parse(b"[[1, 2.5, 3], [4,5,6,0.5], [7,8,9,null]]", 3).unwrap();
        let sigmas: Vec<_> = points.0.iter().map(|point| point.sigma).collect();
        assert_eq!(sigmas, [None, Some(0.5), None]);
        assert_eq!(points.0.as_slice()[0].v, 2.5);
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
            let fault = Points::parse(json.as_bytes(), 9).unwrap_err();
            assert_eq!(fault.kind, Kind::Malformed, "{json}");
        }
        let fault = Points::parse(b"[[1,2,3],[1,2,3]]", 1).unwrap_err();
        assert_eq!(fault.kind, Kind::TooLarge);
    }
}
