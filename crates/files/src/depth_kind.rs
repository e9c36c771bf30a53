//! Whether stored depths are along the optical axis or along the ray.

use crate::error::{Error, Result};
use crate::{Camera, Unit};
use lsdc_core::Observation;
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Definition of stored depths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthKind {
    /// The depth along the optical axis, z.
    Z,
    /// The distance from the optical centre along the ray of the pixel.
    Ray,
}

/// Options for reading depths, as far as the user gave them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DepthReadOptions {
    /// Unit; by default millimetres for integers and metres for other numbers.
    pub unit: Option<Unit>,
    /// Definition of the depths; by default along the optical axis.
    pub kind: Option<DepthKind>,
}

impl From<Option<Unit>> for DepthReadOptions {
    fn from(unit: Option<Unit>) -> Self {
        Self { unit, kind: None }
    }
}

const NAMES: [(&str, DepthKind); 2] = [("z", DepthKind::Z), ("ray", DepthKind::Ray)];

impl FromStr for DepthKind {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let named = NAMES.iter().find(|(name, _)| *name == text);
        named.map(|(_, kind)| *kind).ok_or_else(|| {
            Error::config(format!("`{text}` is no kind of depth")).hint(
                "z: along the optical axis; ray: distances from the optical centre, as of Hypersim and CARLA's \
                 lidar",
            )
        })
    }
}

impl Display for DepthKind {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let name = NAMES.iter().find(|(_, kind)| kind == self);
        write!(f, "{}", name.map_or("", |(name, _)| name))
    }
}

/// Converts an observation with a distance along its ray to a depth: z = d / |K^-1 (u, v, 1)|, for every lens. The standard
/// deviation is scaled equally. `None` if the lens has no ray for this pixel.
pub(crate) fn along_axis(point: Observation, camera: &Camera) -> Option<Observation> {
    let length = length_of_ray([point.u, point.v], camera)?;
    let shorter = |value: f32| (f64::from(value) / length) as f32;
    Some(Observation {
        depth: shorter(point.depth),
        sigma: point.sigma.map(shorter),
        ..point
    })
}

/// Returns the distance from the optical centre to depth 1 along the ray of a pixel; `None` if the lens has no ray for it.
pub(crate) fn length_of_ray(pixel: [f64; 2], camera: &Camera) -> Option<f64> {
    let at = |depth| camera.unproject(pixel, depth);
    let (near, far) = (at(1.0)?, at(2.0)?);
    let squares = near.iter().zip(far).map(|(near, far)| (far - near).powi(2));
    Some(squares.sum::<f64>().sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_seen_along_rays_becomes_flat() {
        // The distance of z = 2 at (u, v): 2 sqrt(1 + x^2 + y^2).
        let camera = Camera::pinhole([100.0, 120.0], [50.0, 40.0]).with_pose(
            [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
            [5.0, -3.0, 2.0],
        );
        for (u, v) in [(50.0, 40.0), (0.0, 0.0), (120.0, 70.0)] {
            let (x, y) = ((u - 50.0) / 100.0, (v - 40.0) / 120.0);
            let length = f64::sqrt(1.0 + x * x + y * y);
            let point = Observation {
                u,
                v,
                depth: (2.0 * length) as f32,
                sigma: Some(0.1),
            };
            let found = along_axis(point, &camera).unwrap();
            assert!((found.depth - 2.0).abs() < 1e-6, "{found:?}");
            assert!((f64::from(found.sigma.unwrap()) - 0.1 / length).abs() < 1e-6);
        }
    }

    #[test]
    fn kinds_are_named() {
        for (name, kind) in NAMES {
            assert_eq!(name.parse::<DepthKind>().unwrap(), kind);
            assert_eq!(kind.to_string(), name);
        }
        assert!(
            "radial"
                .parse::<DepthKind>()
                .unwrap_err()
                .advice()
                .is_some()
        );
    }
}
