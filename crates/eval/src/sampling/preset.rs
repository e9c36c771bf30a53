//! Published protocols by name.

use super::occlusion::Occlusion;
use super::protocol::{Anchor, Jumps};
use super::resize::Interpolation;
use super::{Pattern, Protocol, Size};
use lsdc_files::error::{Error, Result};

/// A published protocol with its pattern of points.
#[derive(Clone, Debug)]
pub struct ProtocolPreset {
    /// Name on the command line.
    pub name: &'static str,
    /// Sizes and valid depths.
    pub protocol: Protocol,
    /// Pattern of sparse points.
    pub points: Pattern,
    /// Publication of the protocol.
    pub source: &'static str,
}

impl ProtocolPreset {
    /// Returns the preset with this name.
    ///
    /// # Errors
    /// There is no such preset.
    pub fn named(name: &str) -> Result<Self> {
        let all = Self::all();
        let names = all.iter().map(|p| p.name).collect::<Vec<_>>().join(", ");
        all.into_iter().find(|p| p.name == name).ok_or_else(|| {
            Error::config(format!("unknown protocol `{name}`")).hint(format!("protocols: {names}"))
        })
    }

    /// Returns all presets.
    pub fn all() -> Vec<Self> {
        let size = |height, width| Some(Size { height, width });
        let nyu = Protocol::nyu();
        vec![
            Self {
                name: "full",
                protocol: Protocol::default(),
                points: Pattern::Exactly(500),
                source: "every pixel of the frame as it is",
            },
            Self {
                name: "nyu",
                protocol: nyu,
                points: Pattern::Exactly(500),
                source: "NLSPN (Park et al. 2020), CompletionFormer, OGNI-DC",
            },
            Self {
                name: "nyu-s2d",
                protocol: Protocol {
                    rgb_resize: Interpolation::PilNearest,
                    depth_resize: Interpolation::PilNearest,
                    ..nyu
                },
                points: Pattern::Bernoulli(500),
                source: "sparse-to-dense (Ma and Karaman 2018), its PyTorch code",
            },
            Self {
                name: "nyu-cspn",
                protocol: nyu,
                points: Pattern::BernoulliAll(500),
                source: "CSPN (Cheng et al. 2018)",
            },
            Self {
                name: "nyu-conti",
                protocol: Protocol {
                    range: Some([1e-4, 8.0]),
                    ..Protocol::default()
                },
                points: Pattern::Given,
                source: "Conti et al. 2023: their crops and points, truth up to 8 m",
            },
            Self {
                name: "diode-paper",
                protocol: nyu,
                points: Pattern::Exactly(1000),
                source: "our reading of Fang et al., table 4: no validity mask, NYU's size",
            },
            Self {
                name: "diode-masked",
                protocol: Protocol {
                    mask: true,
                    range: Some([0.1, 300.0]),
                    depth_resize: Interpolation::CvNearest,
                    ..nyu
                },
                points: Pattern::Exactly(1000),
                source: "the devkit's validity mask, NYU's size",
            },
            Self {
                name: "diode-robustdc",
                protocol: Protocol {
                    mask: true,
                    range: Some([0.1, 300.0]),
                    jumps: Some(Jumps {
                        indoor: 0.05,
                        outdoor: 0.15,
                    }),
                    cut: size(750, 1000),
                    resize: size(480, 640),
                    depth_resize: Interpolation::CvNearest,
                    ..Protocol::default()
                },
                points: Pattern::Exactly(2150),
                source: "OMNI-DC's RobustDC (Zuo et al. 2025), 0.7 % of the pixels",
            },
            Self {
                name: "kitti",
                protocol: Protocol {
                    crop: size(352, 1216),
                    anchor: Anchor::Bottom,
                    ..Protocol::default()
                },
                points: Pattern::Given,
                source: "KITTI depth completion (Uhrig et al. 2017), laser points as they are",
            },
            Self {
                name: "void",
                protocol: Protocol {
                    range: Some([0.2, 5.0]),
                    ..Protocol::default()
                },
                points: Pattern::Given,
                source: "VOID as KBNet (Wong and Soatto 2021): truth of 0.2 to 5 m",
            },
            Self {
                name: "marigold",
                protocol: Protocol::default(),
                points: Pattern::Given,
                source: "Marigold-DC (Viola et al. 2024): no cap, given points",
            },
            Self {
                name: "scans",
                protocol: Protocol {
                    occlusion: Some(Occlusion::default()),
                    ..Protocol::default()
                },
                points: Pattern::Given,
                source: "laser returns as a car has them, scored without those seen past a nearer surface",
            },
            Self {
                name: "scans-filtered",
                protocol: Protocol {
                    occlusion: Some(Occlusion {
                        given: true,
                        ..Occlusion::default()
                    }),
                    ..Protocol::default()
                },
                points: Pattern::Given,
                source: "laser returns, given and scored without those seen past a nearer surface",
            },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_found_by_name() {
        for preset in ProtocolPreset::all() {
            assert_eq!(
                ProtocolPreset::named(preset.name).unwrap().protocol,
                preset.protocol
            );
        }
        let error = ProtocolPreset::named("nuy").unwrap_err();
        assert!(error.advice().unwrap().contains("nyu-s2d"));
    }
}
