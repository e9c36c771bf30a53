//! Options of a completion, with the names of `lsdc complete` and of the service.

use crate::error::{Error, Kind, Result};
use lsdc_core::fit::Changes;
use lsdc_core::settings::{FitMethod, Loss, PriorKind, Robust};
use lsdc_core::{DepthNoise, Observation, Observations};
use serde::Deserialize;

/// Options of a completion. By default, settings are those of the weights, and all outputs are computed.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Options {
    fit: Option<FitMethod>,
    robust: Option<Robustness>,
    prior: Option<PriorKind>,
    /// Standard deviation in metres of points that have none.
    sigma: Option<f32>,
    /// Noise of a depth camera for points without a standard deviation: a name, or A,B,C.
    noise: Option<String>,
    /// Whether the standard deviation of every pixel is computed.
    pub(crate) deviations: bool,
    /// Whether leave-one-out errors are computed, and outliers are found.
    pub(crate) outliers: bool,
}

/// A robust loss, or none.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Robustness {
    None,
    #[serde(untagged)]
    Loss(Loss),
}

impl Default for Options {
    fn default() -> Self {
        Self {
            fit: None,
            robust: None,
            prior: None,
            sigma: None,
            noise: None,
            deviations: true,
            outliers: true,
        }
    }
}

impl Options {
    /// Reads options from JSON.
    ///
    /// # Errors
    /// Invalid JSON, unknown options, or values out of range.
    pub(crate) fn parse(json: &[u8]) -> Result<Self> {
        let options: Self = serde_json::from_slice(json).map_err(|error| {
            let what = format!("the options cannot be read: {error}");
            Error::new(Kind::Settings, what)
        })?;
        let sound = |sigma: f32| sigma > 0.0 && sigma.is_finite();
        if options.sigma.is_some_and(|sigma| !sound(sigma)) {
            let what = "the option `sigma` must be positive and finite";
            return Err(Error::new(Kind::Settings, what));
        }
        if options.sigma.is_some() && options.noise.is_some() {
            let what = "the options `sigma` and `noise` are for the same points";
            return Err(Error::new(Kind::Settings, what).with_hint("give either of them"));
        }
        Ok(options)
    }

    /// Overrides of the settings stored with the weights.
    pub(crate) fn changes(&self) -> Changes {
        Changes {
            method: self.fit,
            robust: self.robust.map(|robust| match robust {
                Robustness::None => None,
                Robustness::Loss(loss) => Some(Robust::new(loss)),
            }),
            prior: self.prior,
        }
    }

    /// Returns the points, with the standard deviation of the options for those that have none.
    ///
    /// # Errors
    /// Unknown noise.
    pub(crate) fn with_deviations(&self, points: Observations) -> Result<Observations> {
        if let Some(noise) = &self.noise {
            let noise: DepthNoise = noise.parse().map_err(lsdc_core::Error::from)?;
            return Ok(noise.applied(&points).0);
        }
        let Some(sigma) = self.sigma else {
            return Ok(points);
        };
        let known = |point: &Observation| Observation {
            sigma: point.sigma.or(Some(sigma)),
            ..*point
        };
        Ok(points.iter().map(known).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_command_line() {
        let parse = |json: String| Options::parse(json.as_bytes()).unwrap().changes();
        let robust = |name: &str| parse(format!("{{\"robust\": \"{name}\"}}")).robust;
        assert_eq!(robust("none"), Some(None));
        for loss in Loss::ALL {
            assert_eq!(robust(loss.name()), Some(Some(Robust::new(loss))));
        }
        for method in FitMethod::ALL {
            let changes = parse(format!("{{\"fit\": \"{}\"}}", method.name()));
            assert_eq!((changes.method, changes.robust), (Some(method), None));
        }
        assert_eq!(
            parse("{\"robust\": null, \"fit\": null}".into()),
            Changes::default()
        );
    }

    #[test]
    fn what_is_unknown_or_out_of_range_is_refused() {
        for json in [
            "",
            "[1]",
            "{\"colour\": 1}",
            "{\"robust\": \"strong\"}",
            "{\"sigma\": 0}",
            "{\"sigma\": 0.1, \"noise\": \"tof\"}",
        ] {
            let error = Options::parse(json.as_bytes()).unwrap_err();
            assert_eq!(error.kind, Kind::Settings, "{json}");
        }
        let radar = Options::parse(b"{\"noise\": \"radar\"}").unwrap();
        let error = radar.with_deviations(Observations::new()).unwrap_err();
        assert_eq!(error.kind, Kind::Settings);
    }

    #[test]
    fn only_points_without_a_deviation_get_that_of_the_options() {
        let mut points = Observations::new();
        points.add(1.0, 2.0, 3.0);
        points.extend([Observation {
            u: 0.0,
            v: 0.0,
            depth: 1.0,
            sigma: Some(0.5),
        }]);
        let options = Options::parse(b"{\"sigma\": 0.25}").unwrap();
        let points = options.with_deviations(points).unwrap();
        let sigmas: Vec<_> = points.iter().map(|point| point.sigma).collect();
        assert_eq!(sigmas, [Some(0.25), Some(0.5)]);
    }
}
