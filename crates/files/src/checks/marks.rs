//! Values that mark missing measurements and background.

use super::{NumberType, Warning};
use std::collections::HashSet;

/// Format of stored numbers.
#[derive(Clone, Copy, Debug)]
pub struct NumberFormat {
    /// Number type.
    pub numbers: NumberType,
    /// Metres per unit.
    pub metres: f64,
    /// Value that the file declares as no measurement: a nodata tag, a fill value.
    pub declared: Option<f64>,
}

/// Backgrounds of renderers and markers of programs in floating-point numbers: the largest unsigned and signed 16-bit
/// integers, also in metres if they were millimetres; the largest binary16 (65504) and binary32; and Blender's.
const FLOATS: [f32; 6] = [65504.0, 65535.0, 65.535, 32767.0, 1e10, f32::MAX];

/// Largest depth in an image in metres, if the others are much nearer.
const BEYOND: f64 = 1e5;
/// How much nearer: factor between the median and values beyond the limit.
const FAR: f32 = 100.0;

/// Smallest share of pixels of a cluster of one value and, below, their smallest number.
const SHARE: f64 = 0.01;
const FEW: usize = 10;

const LARGEST: &str = "the largest number of its type";
const DECLARED: &str = "which the file declares as no data";
const BACKGROUND: &str = "a usual mark of background or of no measurement";
const IMPLAUSIBLE: &str = "implausibly far beyond the other depths, as a background";
const POWER: &str = "the largest number of a sensor with fewer bits";
const GAP: &str = "the same number in many pixels, far from all others";

/// Replaces values that mark missing measurements by NaN. Returns warnings about them, also for values that were kept.
///
/// The declared value is left out, as are values that are 100 times as far as the median and beyond 100 km. The largest
/// integer of the type and known backgrounds of floating-point maps are left out if they are isolated: no value is within the
/// 10 % below, or they occur at 1 % of the measured pixels or more, and ten times as often as values within these 10 %.
/// Otherwise they are kept and reported. Also kept and reported are a largest value that is isolated, frequent and the
/// largest number of fewer bits, and a value at 1 % of the measured pixels or more that is twice as far as the next, or half
/// as near.
pub fn leave_out_marks(values: &mut [f32], known: &NumberFormat) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let all = values.len();
    let mut leave_out = |values: &mut [f32], value: f64, why, is_mark: &dyn Fn(f32) -> bool| {
        let mut count = 0;
        for value in values.iter_mut().filter(|value| is_mark(**value)) {
            *value = f32::NAN;
            count += 1;
        }
        if count > 0 {
            warnings.push(Warning::LeftOut {
                value,
                why,
                count,
                of: all,
            });
        }
    };
    if let Some(declared) = known
        .declared
        .filter(|value| value.is_finite() && *value != 0.0)
    {
        leave_out(values, declared, DECLARED, &|v| v == declared as f32);
    }
    let mut suspected = None;
    // Each round leaves out one value; files with more markers are not known.
    for _ in 0..4 {
        let Some(extremes) = Extremes::of(values) else {
            break;
        };
        let top = extremes.high;
        let beyond = extremes.beyond(values, known.metres);
        if let Some(limit) = beyond {
            leave_out(values, f64::from(top), IMPLAUSIBLE, &|v| {
                v > limit && v.is_finite()
            });
            continue;
        }
        let Some((why, certain)) = candidate(top, known.numbers) else {
            break;
        };
        let below = values
            .iter()
            .filter(|&&v| v >= 0.9 * top && v < top)
            .count();
        let stands_apart = below == 0 || 10 * below <= extremes.high_count;
        let clear =
            stands_apart && (extremes.is_cluster(extremes.high_count) || (certain && below == 0));
        if clear && certain {
            leave_out(values, f64::from(top), why, &|v| v == top);
            continue;
        }
        if certain || clear {
            suspected = Some((top, why, extremes.high_count));
        }
        break;
    }
    if let Some(extremes) = Extremes::of(values) {
        let far =
            extremes.is_cluster(extremes.high_count) && extremes.next_high < 0.5 * extremes.high;
        let near =
            extremes.is_cluster(extremes.low_count) && extremes.next_low > 2.0 * extremes.low;
        // A scene of a few planes has few distinct values, each at many pixels.
        let spread = (far || near) && is_varied(values);
        let high = (far && spread).then_some((extremes.high, GAP, extremes.high_count));
        let low = (near && spread).then_some((extremes.low, GAP, extremes.low_count));
        for (value, why, count) in suspected.or(high).into_iter().chain(low) {
            warnings.push(Warning::Suspected {
                value: f64::from(value),
                why,
                count,
                of: all,
            });
        }
    }
    warnings
}

/// [`leave_out_marks`] for a guide, whose numbers have no unit and often fill the range of their type: a value that is kept
/// is reported only if it is a cluster.
pub fn marks_in_guide(
    values: &mut [f32],
    numbers: NumberType,
    declared: Option<f64>,
) -> Vec<Warning> {
    let known = NumberFormat {
        numbers,
        metres: 1.0,
        declared,
    };
    let mut warnings = leave_out_marks(values, &known);
    let few = (values.len() as f64 * SHARE) as usize;
    warnings.retain(|warning| !matches!(warning, Warning::Suspected { count, .. } if *count < few));
    warnings
}

/// Whether a map has many distinct values.
fn is_varied(values: &[f32]) -> bool {
    const MANY: usize = 32;
    let mut different = HashSet::new();
    let positive = values.iter().filter(|v| **v > 0.0);
    positive.map(|v| v.to_bits()).any(|bits| {
        different.insert(bits);
        different.len() > MANY
    })
}

/// Returns why a largest value may be a marker, and whether it is a known one.
fn candidate(top: f32, numbers: NumberType) -> Option<(&'static str, bool)> {
    match numbers {
        NumberType::Booleans => None,
        NumberType::Floats => FLOATS.contains(&top).then_some((BACKGROUND, true)),
        NumberType::Integers { .. } => {
            if numbers
                .largest()
                .is_some_and(|largest| top == largest as f32)
            {
                return Some((LARGEST, true));
            }
            // 2047 to 32767, and -32768 read as unsigned.
            let power =
                (11..=15).any(|bits| top == f32::from((1_u16 << bits) - 1)) || top == 32768.0;
            power.then_some((POWER, false))
        }
    }
}

/// Extremes of the positive and finite values.
struct Extremes {
    measured: usize,
    high: f32,
    /// Number of pixels with the value `high`.
    high_count: usize,
    next_high: f32,
    low: f32,
    low_count: usize,
    next_low: f32,
}

impl Extremes {
    /// Returns `None` for a map without measurements.
    fn of(values: &[f32]) -> Option<Self> {
        let mut extremes = Self {
            measured: 0,
            high: 0.0,
            high_count: 0,
            next_high: 0.0,
            low: f32::INFINITY,
            low_count: 0,
            next_low: f32::INFINITY,
        };
        for &value in values.iter().filter(|v| **v > 0.0 && v.is_finite()) {
            extremes.measured += 1;
            if value > extremes.high {
                (extremes.next_high, extremes.high, extremes.high_count) =
                    (extremes.high, value, 0);
            }
            if value < extremes.low {
                (extremes.next_low, extremes.low, extremes.low_count) = (extremes.low, value, 0);
            }
            if value == extremes.high {
                extremes.high_count += 1;
            } else {
                extremes.next_high = extremes.next_high.max(value);
            }
            if value == extremes.low {
                extremes.low_count += 1;
            } else {
                extremes.next_low = extremes.next_low.min(value);
            }
        }
        (extremes.measured > 0).then_some(extremes)
    }

    fn is_cluster(&self, count: usize) -> bool {
        count >= FEW && count as f64 >= SHARE * self.measured as f64
    }

    /// Returns the limit above which values are not depths, if any value is above it.
    fn beyond(&self, values: &[f32], metres: f64) -> Option<f32> {
        let limit = (BEYOND / metres) as f32;
        if self.high < limit {
            return None;
        }
        let finite = values.iter().filter(|v| **v > 0.0 && v.is_finite());
        let mut near: Vec<f32> = finite.copied().filter(|v| *v < limit).collect();
        if near.is_empty() {
            return None;
        }
        let middle = near.len() / 2;
        let median = *near.select_nth_unstable_by(middle, f32::total_cmp).1;
        let limit = limit.max(FAR * median);
        (self.high > limit).then_some(limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const U16: NumberType = NumberType::unsigned(16);

    /// 1000 values, of which the first `count` are `mark`; the others start at 1000 and increase in steps of `step`.
    fn with(mark: f32, count: usize, step: f32) -> Vec<f32> {
        let value = |i: usize| {
            if i < count {
                mark
            } else {
                1000.0 + step * i as f32
            }
        };
        (0..1000).map(value).collect()
    }

    fn found(values: &mut [f32], numbers: NumberType, metres: f64) -> Vec<Warning> {
        let known = NumberFormat {
            numbers,
            metres,
            declared: None,
        };
        leave_out_marks(values, &known)
    }

    fn left_out(warnings: &[Warning]) -> Vec<(f64, usize)> {
        let left = |warning: &Warning| match warning {
            Warning::LeftOut { value, count, .. } => Some((*value, *count)),
            _ => None,
        };
        warnings.iter().filter_map(left).collect()
    }

    #[test]
    fn the_largest_number_of_the_type_that_stands_apart_is_left_out() {
        for (numbers, mark) in [
            (U16, 65535.0),
            (NumberType::signed(16), 32767.0),
            (NumberType::signed(32), 2_147_483_647.0),
            (NumberType::unsigned(32), 4_294_967_295.0_f32),
        ] {
            for count in [1, 200, 990] {
                let mut values = with(mark, count, 7.0);
                let warnings = found(&mut values, numbers, 0.001);
                assert_eq!(
                    left_out(&warnings),
                    [(f64::from(mark), count)],
                    "{numbers:?}"
                );
                assert_eq!(values.iter().filter(|v| v.is_nan()).count(), count);
            }
        }
    }

    #[test]
    fn the_largest_number_among_its_like_is_kept_and_reported() {
        // 65535 is one of the regular values.
        let mut values: Vec<f32> = (0..1000).map(|i| 65535.0 - 9.0 * i as f32).collect();
        let warnings = found(&mut values, U16, 0.001);
        assert!(
            matches!(
                warnings[..],
                [Warning::Suspected {
                    value: 65535.0,
                    count: 1,
                    ..
                }]
            ),
            "{warnings:?}"
        );
        assert!(values.iter().all(|v| v.is_finite()));
        // In a guide this is the usual end of the range.
        assert_eq!(marks_in_guide(&mut values, U16, None), []);
        // Sky at the end of a fully used range (Virtual KITTI 2).
        let mut values: Vec<f32> = (0..1000)
            .map(|i| if i < 200 { 65535.0 } else { 60.0 * i as f32 })
            .collect();
        assert_eq!(left_out(&found(&mut values, U16, 0.01)), [(65535.0, 200)]);
    }

    #[test]
    fn backgrounds_of_renderers_are_left_out() {
        for mark in [1e10, 65504.0, f32::MAX, 1e30, 65535.0, 3e8] {
            let mut values: Vec<f32> = with(mark, 300, 7.0)
                .iter()
                .map(|v| if *v == mark { mark } else { v / 1000.0 })
                .collect();
            let warnings = found(&mut values, NumberType::Floats, 1.0);
            assert_eq!(left_out(&warnings), [(f64::from(mark), 300)]);
        }
        // Interpolated edges of a background have values in between.
        let mut values = vec![1e10, 5e9, 1e8, 2.0, 3.0, 4.0, 2.5, f32::NAN, -1.0, 0.0];
        let warnings = found(&mut values, NumberType::Floats, 1.0);
        assert_eq!(left_out(&warnings), [(1e10, 3)]);
    }

    #[test]
    fn two_marks_in_one_map_are_both_left_out() {
        let mut values: Vec<f32> = (0..1000).map(|i| 1.0 + i as f32 * 0.01).collect();
        values[..100].fill(1e10);
        values[100..200].fill(65504.0);
        let warnings = found(&mut values, NumberType::Floats, 1.0);
        assert_eq!(left_out(&warnings), [(1e10, 100), (65504.0, 100)]);
    }

    #[test]
    fn a_declared_value_is_left_out_wherever_it_lies() {
        let mut values = with(1500.0, 3, 1.0);
        let before = values.iter().filter(|v| **v == 1500.0).count();
        let known = NumberFormat {
            numbers: U16,
            metres: 0.001,
            declared: Some(1500.0),
        };
        assert_eq!(
            left_out(&leave_out_marks(&mut values, &known)),
            [(1500.0, before)]
        );
    }

    #[test]
    fn a_cluster_far_from_all_others_is_reported() {
        for (mark, numbers) in [(9999.0, NumberType::Floats), (30000.0, U16), (4.0, U16)] {
            let mut values = with(mark, 50, 2.0);
            let warnings = found(&mut values, numbers, 0.001);
            assert!(
                matches!(warnings[..], [Warning::Suspected { count: 50, .. }]),
                "{mark}: {warnings:?}"
            );
        }
    }

    #[test]
    fn maps_without_marks_stay_as_they_are() {
        let ramp = with(0.0, 0, 7.0);
        let far_wall: Vec<f32> = (0..1000)
            .map(|i| if i < 300 { 8.0 } else { 1.0 + 0.007 * i as f32 })
            .collect();
        for (values, numbers) in [
            (ramp, U16),
            (far_wall, NumberType::Floats),
            (vec![2.0; 1000], NumberType::Floats),
            (
                [[1.0; 300], [2.0; 300], [9.0; 300]].concat(),
                NumberType::Floats,
            ),
            (vec![0.0; 10], U16),
            (vec![255.0, 0.0, 255.0], NumberType::Booleans),
        ] {
            let mut copy = values.clone();
            assert_eq!(found(&mut copy, numbers, 0.001), []);
            assert_eq!(copy, values);
        }
    }
}
