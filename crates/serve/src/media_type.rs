//! The media types of answers, and which of them a client prefers.

use crate::fault::{Fault, FaultKind};

/// The media types of answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MediaType {
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

impl MediaType {
    /// All types; the first is the default.
    const ALL: [Self; 6] = [
        Self::Json,
        Self::Png,
        Self::Exr,
        Self::Npz,
        Self::Ply,
        Self::Layers,
    ];

    /// The name, as in `Content-Type`.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Png => "image/png",
            Self::Exr => "image/x-exr",
            Self::Npz => "application/x-npz",
            Self::Ply => "application/x-ply",
            Self::Layers => "application/vnd.lsdc.layers",
        }
    }

    /// The file name of an answer that is a file.
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
    pub(crate) fn needs_depth(self) -> bool {
        self != Self::Layers
    }

    /// Whether it has room for standard deviations.
    pub(crate) fn has_deviations(self) -> bool {
        matches!(self, Self::Exr | Self::Npz | Self::Ply | Self::Layers)
    }

    /// Whether it has room for outliers.
    pub(crate) fn has_outliers(self) -> bool {
        matches!(self, Self::Json | Self::Layers)
    }

    /// The media type that an `Accept` header prefers (RFC 9110, section 12.5.1), the first of equals.
    ///
    /// # Errors
    /// None of them is acceptable.
    pub(crate) fn accepted(header: Option<&str>) -> Result<Self, Fault> {
        let Some(header) = header.filter(|text| !text.trim().is_empty()) else {
            return Ok(Self::Json);
        };
        let ranges: Vec<(&str, f32)> = header.split(',').map(range).collect();
        // The most precise range that matches decides.
        let weight = |media_type: Self| {
            let name = media_type.name();
            let kind = name.split('/').next().unwrap_or_default();
            let precision = |range: &str| match range.split_once('/') {
                Some(("*", "*")) => Some(0),
                Some((own, "*")) if own.eq_ignore_ascii_case(kind) => Some(1),
                _ if range.eq_ignore_ascii_case(name) => Some(2),
                _ => None,
            };
            let matching = ranges
                .iter()
                .filter_map(|(range, weight)| Some((precision(range)?, *weight)));
            matching
                .max_by_key(|(precision, _)| *precision)
                .map_or(0.0, |(_, weight)| weight)
        };
        // `max_by` returns the last of equal elements.
        let weights = Self::ALL
            .into_iter()
            .rev()
            .map(|known| (known, weight(known)));
        let acceptable = weights.filter(|(_, weight)| *weight > 0.0);
        let best = acceptable.max_by(|(_, a), (_, b)| a.total_cmp(b));
        best.map(|(best, _)| best).ok_or_else(|| {
            let known = Self::ALL.map(Self::name).join(", ");
            let what = "there is no answer in a form of `Accept`";
            Fault::new(FaultKind::NotAcceptable, what).hint(format!("accept one of {known}"))
        })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_media_type_is_the_one_of_the_largest_weight() {
        for (header, expected) in [
            ("*/*", MediaType::Json),
            ("image/png", MediaType::Png),
            ("IMAGE/PNG", MediaType::Png),
            ("image/*", MediaType::Png),
            ("image/*;q=0.5, application/x-npz;q=0.7", MediaType::Npz),
            ("text/html, application/x-ply;q=0.1", MediaType::Ply),
            ("*/*;q=0.1, image/x-exr", MediaType::Exr),
            ("*/*, application/json;q=0, image/png;q=0", MediaType::Exr),
            ("application/vnd.lsdc.layers", MediaType::Layers),
        ] {
            assert_eq!(
                MediaType::accepted(Some(header)).unwrap(),
                expected,
                "{header}"
            );
        }
        assert_eq!(MediaType::accepted(None).unwrap(), MediaType::Json);
        for header in ["text/html", "image/png;q=0", "image/png;q=x", ";;,,"] {
            assert!(MediaType::accepted(Some(header)).is_err(), "{header}");
        }
    }
}
