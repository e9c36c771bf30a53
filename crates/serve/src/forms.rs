//! The forms of an answer: which one a client likes best, and what each makes of a result.

use crate::fault::{Fault, Kind};
use lsdc_files::{Cloud, Unit};

/// The forms of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// The report.
    Json,
    /// 16 bits, millimetres.
    Png,
    /// Channels Z and sigma.
    Exr,
    /// Arrays `depth` and `sigma`.
    Npz,
    /// A coloured cloud.
    Ply,
    /// All maps and the report, for the page.
    Layers,
}

impl Form {
    /// All of them; the first is that of a client that does not care.
    const ALL: [Self; 6] = [
        Self::Json,
        Self::Png,
        Self::Exr,
        Self::Npz,
        Self::Ply,
        Self::Layers,
    ];

    /// The media type.
    pub(crate) fn media(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Png => "image/png",
            Self::Exr => "image/x-exr",
            Self::Npz => "application/x-npz",
            Self::Ply => "application/x-ply",
            Self::Layers => "application/vnd.lsdc.layers",
        }
    }

    /// What a file of it is called, if it is one.
    pub(crate) fn file(self) -> Option<&'static str> {
        match self {
            Self::Json | Self::Layers => None,
            Self::Png => Some("depth.png"),
            Self::Exr => Some("depth.exr"),
            Self::Npz => Some("depth.npz"),
            Self::Ply => Some("cloud.ply"),
        }
    }

    /// Whether it needs the depth of every pixel.
    pub(crate) fn is_of_depth(self) -> bool {
        self != Self::Layers
    }

    /// Whether it has room for standard deviations.
    pub(crate) fn has_deviations(self) -> bool {
        matches!(self, Self::Exr | Self::Npz | Self::Ply | Self::Layers)
    }

    /// Whether it says something of points.
    pub(crate) fn names_points(self) -> bool {
        matches!(self, Self::Json | Self::Layers)
    }

    /// The form that an `Accept` header likes best (RFC 9110, section 12.5.1); of equals the first here.
    ///
    /// # Errors
    /// None of them is acceptable.
    pub(crate) fn accepted(header: Option<&str>) -> Result<Self, Fault> {
        let Some(header) = header.filter(|text| !text.trim().is_empty()) else {
            return Ok(Self::Json);
        };
        let ranges: Vec<(&str, f32)> = header.split(',').map(range).collect();
        // The most precise range that fits says how much a form is liked.
        let liked = |form: Self| {
            let kind = form.media().split('/').next().unwrap_or_default();
            let precision = |range: &str| match range.split_once('/') {
                Some(("*", "*")) => Some(0),
                Some((own, "*")) if own.eq_ignore_ascii_case(kind) => Some(1),
                _ if range.eq_ignore_ascii_case(form.media()) => Some(2),
                _ => None,
            };
            let fitting = ranges
                .iter()
                .filter_map(|(range, liking)| Some((precision(range)?, *liking)));
            fitting
                .max_by_key(|(precision, _)| *precision)
                .map_or(0.0, |(_, liking)| liking)
        };
        let mut best = (Self::Json, 0.0);
        for form in Self::ALL {
            if liked(form) > best.1 {
                best = (form, liked(form));
            }
        }
        if best.1 > 0.0 {
            return Ok(best.0);
        }
        let known = Self::ALL.map(Self::media).join(", ");
        Err(Fault::new(
            Kind::NotAcceptable,
            "there is no answer in a form of `Accept`",
        )
        .hint(format!("accept one of {known}")))
    }
}

/// A media range and its weight, without other parameters.
fn range(text: &str) -> (&str, f32) {
    let mut parts = text.split(';').map(str::trim);
    let range = parts.next().unwrap_or_default();
    let weight = parts.find_map(|part| {
        let (name, value) = part.split_once('=')?;
        name.trim()
            .eq_ignore_ascii_case("q")
            .then(|| value.trim().parse().ok())
    });
    let weight = weight.map_or(1.0, |weight: Option<f32>| weight.unwrap_or(0.0));
    (range, weight.clamp(0.0, 1.0))
}

/// What a form makes of a result, and what is lost with it.
#[derive(Default)]
pub(crate) struct Forms {
    pub(crate) png: Option<Png>,
    pub(crate) cloud: Option<Cloud>,
}

/// A 16-bit PNG.
#[derive(Clone, Copy)]
pub(crate) struct Png {
    pub(crate) unit: Unit,
    /// Pixels nearer than half a unit, which are written as one.
    pub(crate) raised: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_form_is_the_one_that_is_liked_best() {
        for (header, form) in [
            ("*/*", Form::Json),
            ("image/png", Form::Png),
            ("IMAGE/PNG", Form::Png),
            ("image/*", Form::Png),
            ("image/*;q=0.5, application/x-npz;q=0.7", Form::Npz),
            ("text/html, application/x-ply;q=0.1", Form::Ply),
            ("*/*;q=0.1, image/x-exr", Form::Exr),
            ("*/*, application/json;q=0, image/png;q=0", Form::Exr),
            ("application/vnd.lsdc.layers", Form::Layers),
        ] {
            assert_eq!(Form::accepted(Some(header)).unwrap(), form, "{header}");
        }
        assert_eq!(Form::accepted(None).unwrap(), Form::Json);
        for header in ["text/html", "image/png;q=0", "image/png;q=x", ";;,,"] {
            assert!(Form::accepted(Some(header)).is_err(), "{header}");
        }
    }
}
