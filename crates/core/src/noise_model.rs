//! The standard deviation of the measurements of depth cameras, as a function of depth.

use crate::error::SettingsError;
use crate::observations::{Observation, Observations};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// The standard deviation of a depth camera's measurements: A + B z + C z^2 metres at a depth of z metres.
///
/// ```
/// use lsdc_core::{DepthNoise, Observations};
///
/// let noise: DepthNoise = "kinect".parse()?;
/// assert!((noise.at(4.0) - 0.0258).abs() < 1e-4);
/// let mut points = Observations::new();
/// points.add(10.0, 20.0, 4.0);
/// let (points, counted) = noise.applied(&points);
/// assert_eq!(counted, 1);
/// assert_eq!(points.as_slice()[0].sigma, Some(noise.at(4.0) as f32));
/// # Ok::<(), lsdc_core::SettingsError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthNoise {
    coefficients: [f64; 3],
}

impl DepthNoise {
    /// Kinect v1 and other sensors of `PrimeSense` (structured light): 0.0012 + 0.0019 (z - 0.4)^2 metres, the axial noise that
    /// Nguyen, Izadi and Lovell (2012, equation 3) measured on planes rotated by 10 to 60 degrees. Khoshelham and Oude Elberink
    /// (2012) report 0.0014 z^2 for planes that face the sensor.
    pub const KINECT: Self = Self {
        coefficients: [0.001_504, -0.001_52, 0.0019],
    };

    /// Intel `RealSense` D435 (active stereo), by Intel's formula z^2 s / (f b) with an error of matching s of 0.08 pixels,
    /// a focal length f of 447 pixels (848 columns in 87 degrees) and a base b of 50 mm ("Best-Known-Methods for Tuning
    /// `RealSense` D400 Depth Cameras", 2019).
    pub const REALSENSE: Self = Self {
        coefficients: [0.0, 0.0, 0.0036],
    };

    /// Kinect v2 and other time-of-flight cameras: 1.5 - 0.5 z + 0.3 z^2 millimetres, the axial noise on planes that face
    /// the sensor of Fankhauser et al. (2015).
    pub const TOF: Self = Self {
        coefficients: [0.0015, -0.0005, 0.0003],
    };

    /// The models with names.
    pub const NAMED: [(&'static str, Self); 3] = [
        ("kinect", Self::KINECT),
        ("realsense", Self::REALSENSE),
        ("tof", Self::TOF),
    ];

    /// A model by its coefficients A, B and C.
    ///
    /// # Errors
    /// A number that is not finite, or a standard deviation that is not positive at some depth.
    pub fn new([a, b, c]: [f64; 3]) -> Result<Self, SettingsError> {
        let finite = [a, b, c].iter().all(|v| v.is_finite());
        // No root above 0: both ends are non-negative, and the parabola between them is positive.
        let ends = a >= 0.0 && c >= 0.0 && a.max(b).max(c) > 0.0;
        let between = b >= 0.0 || b * b < 4.0 * a * c;
        if finite && ends && between {
            return Ok(Self {
                coefficients: [a, b, c],
            });
        }
        Err(SettingsError::new(format!(
            "a noise of {a} + {b} z + {c} z^2 is not positive at every depth z"
        ))
        .with_hint("as in 0.001,0,0.002: metres, at depths in metres"))
    }

    /// A, B and C.
    pub fn coefficients(self) -> [f64; 3] {
        self.coefficients
    }

    /// The name, if the model has one.
    pub fn name(self) -> Option<&'static str> {
        let mut named = Self::NAMED.iter();
        named
            .find(|(_, model)| *model == self)
            .map(|(name, _)| *name)
    }

    /// The standard deviation at a depth, both in metres.
    pub fn at(self, depth: f64) -> f64 {
        let [a, b, c] = self.coefficients;
        a + depth * (b + depth * c)
    }

    /// Returns observations in metres, with the standard deviation of this model where none is given, and the number of such
    /// observations. Observations without a positive depth are not changed.
    pub fn applied(self, observations: &Observations) -> (Observations, usize) {
        let mut count = 0;
        let with_sigma = |point: &Observation| {
            let depth = f64::from(point.depth);
            if point.sigma.is_some() || !(depth > 0.0 && depth.is_finite()) {
                return *point;
            }
            count += 1;
            Observation {
                sigma: Some(self.at(depth) as f32),
                ..*point
            }
        };
        (observations.iter().map(with_sigma).collect(), count)
    }
}

impl FromStr for DepthNoise {
    type Err = SettingsError;

    /// A name, or A,B,C.
    fn from_str(text: &str) -> Result<Self, SettingsError> {
        if let Some((_, model)) = Self::NAMED.iter().find(|(name, _)| *name == text) {
            return Ok(*model);
        }
        let numbers = text.split(',').map(|number| number.trim().parse());
        let numbers: Result<Vec<f64>, _> = numbers.collect();
        match numbers.as_deref() {
            Ok(&[a, b, c]) => Self::new([a, b, c]),
            _ => Err(
                SettingsError::new(format!("`{text}` is no noise of a depth camera")).with_hint(
                    "kinect, realsense, tof, or three numbers A,B,C of the standard deviation A + B z + C z^2 in metres",
                ),
            ),
        }
    }
}

impl Display for DepthNoise {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let terms = self.coefficients.into_iter().zip(["", " z", " z^2"]);
        let mut first = true;
        for (value, power) in terms.filter(|(value, _)| *value != 0.0) {
            let sign = match (first, value < 0.0) {
                (true, true) => "-",
                (true, false) => "",
                (false, true) => " - ",
                (false, false) => " + ",
            };
            write!(f, "{sign}{}{power}", value.abs())?;
            first = false;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The published formulas, as printed.
    #[test]
    fn named_models_are_those_of_the_papers() {
        let nguyen = |z: f64| 0.0012 + 0.0019 * (z - 0.4).powi(2);
        let focal = 848.0 / 2.0 / (87.0_f64 / 2.0).to_radians().tan();
        let intel = |z: f64| z * z * 0.08 / (focal * 0.05);
        let fankhauser = |z: f64| (1.5 - 0.5 * z + 0.3 * z * z) / 1000.0;
        for z in [0.3, 1.0, 2.5, 7.0] {
            assert!((DepthNoise::KINECT.at(z) - nguyen(z)).abs() < 1e-12);
            assert!((DepthNoise::TOF.at(z) - fankhauser(z)).abs() < 1e-12);
            assert!((DepthNoise::REALSENSE.at(z) / intel(z) - 1.0).abs() < 0.01);
        }
        // Khoshelham and Oude Elberink: about 4 cm at 5 m.
        assert!((DepthNoise::KINECT.at(5.0) - 0.04).abs() < 0.002);
        for (name, model) in DepthNoise::NAMED {
            assert_eq!(name.parse(), Ok(model));
            assert_eq!(model.name(), Some(name));
            assert_eq!(DepthNoise::new(model.coefficients()), Ok(model));
        }
    }

    #[test]
    fn three_numbers_make_a_model_that_is_positive_everywhere() {
        let model: DepthNoise = "0.001, -0.002,0.003".parse().unwrap();
        assert_eq!(model.coefficients(), [0.001, -0.002, 0.003]);
        assert_eq!(model.to_string(), "0.001 - 0.002 z + 0.003 z^2");
        assert_eq!(
            "0,0.01,0".parse::<DepthNoise>().unwrap().to_string(),
            "0.01 z"
        );
        for text in [
            "",
            "d435",
            "1,2",
            "1,2,3,4",
            "1,x,2",
            "0,0,0",
            "-1,0,1",
            "1,0,-1",
            "nan,1,1",
            "inf,0,0",
            "0.001,-0.1,0.002",
        ] {
            let error = text.parse::<DepthNoise>().unwrap_err();
            assert!(crate::Error::from(error).hint().is_some(), "{text}");
        }
    }

    #[test]
    fn known_deviations_and_missing_depths_stay() {
        let mut points = Observations::new();
        points.push(Observation {
            u: 1.0,
            v: 2.0,
            depth: 2.0,
            sigma: Some(0.5),
        });
        for depth in [2.0, 0.0, f32::NAN] {
            points.add(1.0, 2.0, depth);
        }
        let (found, count) = DepthNoise::KINECT.applied(&points);
        assert_eq!(count, 1);
        let sigmas: Vec<_> = found.iter().map(|point| point.sigma).collect();
        let own = DepthNoise::KINECT.at(2.0) as f32;
        assert_eq!(sigmas, [Some(0.5), Some(own), None, None]);
    }
}
