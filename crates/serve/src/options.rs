//! Options of a completion, by the names that `lsdc complete` uses.

use crate::fault::Fault;
use crate::upload::Upload;
use lsdc_core::DepthNoise;
use lsdc_core::fit::Changes;
use lsdc_core::settings::{FitMethod, Loss, PriorKind, Robust};
use lsdc_files::{CloudOptions, DepthReadOptions, DeviationLimits};
use serde::Deserialize;

/// An output beside the report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum OutputLayer {
    /// The dense depth.
    Depth,
    /// The standard deviation of every pixel.
    StandardDeviation,
    /// The points that are probably wrong.
    Outliers,
}

/// Options of a completion; what is missing is as the weights say.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Options {
    fit: Option<FitMethod>,
    robust: Option<Robustness>,
    prior: Option<PriorKind>,
    /// Metres, for points without a standard deviation of their own.
    pub(crate) sigma: Option<f32>,
    /// The noise of a depth camera, for points without a standard deviation of their own: a name, or A,B,C.
    noise: Option<String>,
    depth_unit: Option<String>,
    depth_kind: Option<String>,
    /// Metres: pixels with a larger standard deviation are left out of clouds.
    pub(crate) max_sigma: Option<f32>,
    /// A share of the depth, with the same effect; without it, what counts as measured.
    max_relative_sigma: Option<f32>,
    /// Metres: clouds have one point for each cube of this edge length.
    voxel: Option<f64>,
    /// Whether clouds keep the pixels between the surfaces at depth edges.
    keep_flying: bool,
    layers: Option<Vec<OutputLayer>>,
}

/// A robust loss, or none.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(untagged)]
enum Robustness {
    Plain(Plain),
    Loss(Loss),
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Plain {
    None,
}

impl Options {
    /// Reads the part `options`, if there is one.
    ///
    /// # Errors
    /// As for [`Self::parse`].
    pub(crate) fn read(upload: &Upload) -> Result<Self, Fault> {
        let Some(path) = upload.get("options") else {
            return Ok(Self::default());
        };
        let json = std::fs::read(path).map_err(|_| Fault::failed())?;
        Self::parse(&json)
    }

    /// Reads options from JSON.
    ///
    /// # Errors
    /// No JSON, unknown options, or values out of range.
    pub(crate) fn parse(json: &[u8]) -> Result<Self, Fault> {
        let options: Self = serde_json::from_slice(json)
            .map_err(|e| Fault::malformed(format!("the options cannot be read: {e}")))?;
        options.checked()
    }

    pub(crate) fn checked(self) -> Result<Self, Fault> {
        let metres = [
            ("sigma", self.sigma.map(f64::from)),
            ("max_sigma", self.max_sigma.map(f64::from)),
            ("max_relative_sigma", self.max_relative_sigma.map(f64::from)),
            ("voxel", self.voxel),
        ];
        for (name, value) in metres {
            if value.is_some_and(|value| !(value > 0.0 && value.is_finite())) {
                let what = format!("the option `{name}` must be positive and finite");
                return Err(Fault::unusable(what));
            }
        }
        if self.sigma.is_some() && self.noise.is_some() {
            let what = "the options `sigma` and `noise` are for the same points";
            return Err(Fault::unusable(what).hint("give either of them"));
        }
        self.stored_as()?;
        self.noise()?;
        Ok(self)
    }

    /// The noise of a depth camera, if one is named.
    pub(crate) fn noise(&self) -> Result<Option<DepthNoise>, Fault> {
        let noise = self.noise.as_deref().map(str::parse::<DepthNoise>);
        noise
            .transpose()
            .map_err(|error| lsdc_core::Error::from(error).into())
    }

    /// Which pixels become points of a cloud.
    pub(crate) fn cloud(&self) -> CloudOptions {
        let measured = DeviationLimits::MEASURED as f32;
        CloudOptions {
            limits: DeviationLimits {
                absolute: self.max_sigma,
                relative: Some(self.max_relative_sigma.unwrap_or(measured)),
            },
            keep_flying: self.keep_flying,
            voxel: self.voxel,
        }
    }

    /// Overrides of the settings stored with the weights.
    pub(crate) fn changes(&self) -> Changes {
        Changes {
            method: self.fit,
            robust: self.robust.map(|robust| match robust {
                Robustness::Plain(Plain::None) => None,
                Robustness::Loss(loss) => Some(Robust::new(loss)),
            }),
            prior: self.prior,
        }
    }

    /// The unit and kind of the depths of a file, as far as they are given.
    pub(crate) fn stored_as(&self) -> Result<DepthReadOptions, Fault> {
        Ok(DepthReadOptions {
            unit: self.depth_unit.as_deref().map(str::parse).transpose()?,
            kind: self.depth_kind.as_deref().map(str::parse).transpose()?,
        })
    }

    /// Whether the answer should have an output; all, by default.
    pub(crate) fn wants(&self, layer: OutputLayer) -> bool {
        let layers = self.layers.as_ref();
        layers.is_none_or(|layers| layers.contains(&layer))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::FaultKind;

    #[test]
    fn names_are_those_of_the_command_line() {
        let robust = |name: &str| {
            let json = format!("{{\"robust\": \"{name}\"}}");
            Options::parse(json.as_bytes()).map(|options| options.changes().robust)
        };
        assert_eq!(robust("none").unwrap(), Some(None));
        for loss in Loss::ALL {
            let found = robust(loss.name()).unwrap();
            assert_eq!(found, Some(Some(Robust::new(loss))));
        }
        assert!(robust("strong").is_err());
        for method in FitMethod::ALL {
            let json = format!("{{\"fit\": \"{}\", \"robust\": null}}", method.name());
            let changes = Options::parse(json.as_bytes()).unwrap().changes();
            assert_eq!((changes.method, changes.robust), (Some(method), None));
        }
    }

    #[test]
    fn what_is_not_known_or_out_of_range_is_refused() {
        for (json, kind) in [
            ("{\"colour\": 1}", FaultKind::Malformed),
            ("[1]", FaultKind::Malformed),
            ("{\"sigma\": -1}", FaultKind::Unusable),
            ("{\"max_sigma\": 0}", FaultKind::Unusable),
            ("{\"max_relative_sigma\": -0.1}", FaultKind::Unusable),
            ("{\"voxel\": 0}", FaultKind::Unusable),
            ("{\"keep_flying\": \"yes\"}", FaultKind::Malformed),
            ("{\"depth_unit\": \"furlong\"}", FaultKind::Unusable),
            ("{\"noise\": \"radar\"}", FaultKind::Unusable),
            ("{\"noise\": \"tof\", \"sigma\": 0.1}", FaultKind::Unusable),
            ("{\"depth_kind\": \"slant\"}", FaultKind::Unusable),
            ("{\"layers\": [\"normals\"]}", FaultKind::Malformed),
        ] {
            assert_eq!(
                Options::parse(json.as_bytes()).unwrap_err().kind,
                kind,
                "{json}"
            );
        }
        let options = Options::parse(b"{\"layers\": [\"depth\"]}").unwrap();
        assert!(options.wants(OutputLayer::Depth) && !options.wants(OutputLayer::Outliers));
        assert!(Options::default().wants(OutputLayer::StandardDeviation));
    }
}
