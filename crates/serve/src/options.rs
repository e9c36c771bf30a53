//! What a request asks of the fit and of the answer, by the names that `lsdc complete` uses.

use crate::fault::Fault;
use lsdc_core::fit::Changes;
use lsdc_core::settings::{FitMethod, Loss, PriorKind, Robust, Space};
use lsdc_files::StoredAs;
use serde::Deserialize;

/// What is made of a fit, beside the report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Layer {
    /// The dense depth.
    Depth,
    /// The standard deviation of every pixel.
    StandardDeviation,
    /// Which points are probably wrong.
    Outliers,
}

/// Options of a completion; what is missing is as the weights say.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Options {
    fit: Option<FitMethod>,
    robust: Option<Robustness>,
    prior: Option<PriorKind>,
    space: Option<Space>,
    /// Metres, for points without a standard deviation of their own.
    pub(crate) sigma: Option<f32>,
    depth_unit: Option<String>,
    depth_kind: Option<String>,
    /// Metres: pixels that are less sure are left out of clouds.
    pub(crate) max_sigma: Option<f32>,
    layers: Option<Vec<Layer>>,
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
        for (name, value) in [("sigma", self.sigma), ("max_sigma", self.max_sigma)] {
            if value.is_some_and(|value| !(value > 0.0 && value.is_finite())) {
                let what = format!("the option `{name}` must be positive and finite");
                return Err(Fault::unusable(what));
            }
        }
        self.stored_as()?;
        Ok(self)
    }

    /// What takes the place of the settings of the weights.
    pub(crate) fn changes(&self) -> Changes {
        Changes {
            method: self.fit,
            robust: self.robust.map(|robust| match robust {
                Robustness::Plain(Plain::None) => None,
                Robustness::Loss(loss) => Some(Robust::new(loss)),
            }),
            prior: self.prior,
            space: self.space,
        }
    }

    /// What the depths of a file are, as far as that is said.
    pub(crate) fn stored_as(&self) -> Result<StoredAs, Fault> {
        Ok(StoredAs {
            unit: self.depth_unit.as_deref().map(str::parse).transpose()?,
            kind: self.depth_kind.as_deref().map(str::parse).transpose()?,
        })
    }

    /// Whether a layer is asked for; all are, where nothing is said.
    pub(crate) fn wants(&self, layer: Layer) -> bool {
        let layers = self.layers.as_ref();
        layers.is_none_or(|layers| layers.contains(&layer))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::Kind;

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
            ("{\"colour\": 1}", Kind::Malformed),
            ("[1]", Kind::Malformed),
            ("{\"sigma\": -1}", Kind::Unusable),
            ("{\"max_sigma\": 0}", Kind::Unusable),
            ("{\"depth_unit\": \"furlong\"}", Kind::Unusable),
            ("{\"depth_kind\": \"slant\"}", Kind::Unusable),
            ("{\"layers\": [\"normals\"]}", Kind::Malformed),
        ] {
            assert_eq!(
                Options::parse(json.as_bytes()).unwrap_err().kind,
                kind,
                "{json}"
            );
        }
        let options = Options::parse(b"{\"layers\": [\"depth\"]}").unwrap();
        assert!(options.wants(Layer::Depth) && !options.wants(Layer::Outliers));
        assert!(Options::default().wants(Layer::StandardDeviation));
    }
}
