//! Lens models, which describe the distortion of image positions.

/// A lens model, which describes the distortion of image positions.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Lens {
    /// No distortion.
    Pinhole,
    /// Brown's radial and tangential distortion as in OpenCV: k1, k2, p1, p2, k3, k4, k5, k6. Beyond a
    /// certain radius (the tangent of the angle to the axis), the image folds back.
    #[non_exhaustive]
    Radtan {
        /// Coefficients in the order of `OpenCV`.
        coefficients: [f64; 8],
        /// The radius at which the image begins to fold back.
        radius: f64,
    },
    /// The fisheye model of Kannala and Brandt (2006) as in OpenCV's fisheye module: k1 to k4. Beyond a
    /// certain angle to the axis, the image folds back.
    #[non_exhaustive]
    Fisheye {
        /// Coefficients in the order of `OpenCV`.
        coefficients: [f64; 4],
        /// The angle at which the image begins to fold back.
        angle: f64,
    },
}

/// Number of Newton steps to invert the distortion.
const STEPS: usize = 20;

impl Lens {
    /// Brown's radial and tangential distortion: k1, k2, p1, p2, k3, k4, k5, k6.
    pub fn radial_tangential(coefficients: [f64; 8]) -> Self {
        /// The tangent of 84 degrees.
        const LAST: f64 = 10.0;
        Self::Radtan {
            coefficients,
            radius: fold(LAST, |r| r * radial(&coefficients, r * r)),
        }
    }

    /// The fisheye model of Kannala and Brandt: k1 to k4.
    pub fn fisheye(coefficients: [f64; 4]) -> Self {
        Self::Fisheye {
            coefficients,
            angle: fold(std::f64::consts::FRAC_PI_2, |a| {
                fisheye_radius(&coefficients, a)
            }),
        }
    }

    /// The name in camera files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Pinhole => "pinhole",
            Self::Radtan { .. } => "radtan",
            Self::Fisheye { .. } => "fisheye",
        }
    }

    /// The coefficients in the order of `OpenCV`; none for a pinhole.
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Self::Pinhole => &[],
            Self::Radtan { coefficients, .. } => coefficients,
            Self::Fisheye { coefficients, .. } => coefficients,
        }
    }

    /// The image position of a ray through (x, y, 1), in focal lengths from the principal point.
    pub(super) fn distort(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let square = x * x + y * y;
        match self {
            Self::Pinhole => Some([x, y]),
            Self::Radtan {
                coefficients,
                radius,
            } => {
                if square > radius * radius {
                    return None;
                }
                let [_, _, p1, p2, ..] = *coefficients;
                let radial = radial(coefficients, square);
                Some([
                    x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
                    y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
                ])
            }
            Self::Fisheye {
                coefficients,
                angle: last,
            } => {
                let radius = square.sqrt();
                if radius < 1e-12 {
                    return Some([x, y]);
                }
                let angle = radius.atan();
                if angle > *last {
                    return None;
                }
                let distorted = fisheye_radius(coefficients, angle);
                Some([x * distorted / radius, y * distorted / radius])
            }
        }
    }

    /// Returns the ray of an image position, by inverting the distortion with Newton's method.
    pub(super) fn undistort(&self, distorted: [f64; 2]) -> Option<[f64; 2]> {
        const DIFFERENCE: f64 = 1e-6;
        const NEAR: f64 = 1e-9;
        if *self == Self::Pinhole {
            return Some(distorted);
        }
        let mut ray = match self {
            // A fisheye lens is inverted in angles, because tangents diverge.
            Self::Fisheye { angle: last, .. } => {
                let angle = (distorted[0].powi(2) + distorted[1].powi(2)).sqrt();
                let factor = angle.clamp(1e-12, last.min(1.5)).tan() / angle.max(1e-12);
                distorted.map(|v| v * factor)
            }
            _ => distorted,
        };
        for _ in 0..STEPS {
            let here = self.distort(ray)?;
            let error = [here[0] - distorted[0], here[1] - distorted[1]];
            if error[0].abs().max(error[1].abs()) < NEAR {
                return Some(ray);
            }
            let right = self.distort([ray[0] + DIFFERENCE, ray[1]])?;
            let below = self.distort([ray[0], ray[1] + DIFFERENCE])?;
            let [a, c] = [0, 1].map(|axis| (right[axis] - here[axis]) / DIFFERENCE);
            let [b, d] = [0, 1].map(|axis| (below[axis] - here[axis]) / DIFFERENCE);
            let determinant = a * d - b * c;
            ray[0] -= (d * error[0] - b * error[1]) / determinant;
            ray[1] -= (a * error[1] - c * error[0]) / determinant;
        }
        None
    }
}

/// Returns the largest value up to which image positions move outwards with the rays; infinite if that is `last`.
fn fold(last: f64, distorted: impl Fn(f64) -> f64) -> f64 {
    /// Number of samples of the search.
    const STEPS: usize = 1000;
    let at = |step: usize| last * step as f64 / STEPS as f64;
    let rising = (1..=STEPS).take_while(|&step| distorted(at(step)) > distorted(at(step - 1)));
    match rising.last() {
        Some(STEPS) => f64::INFINITY,
        step => at(step.unwrap_or(0)),
    }
}

/// The distance from the principal point, in focal lengths, of a ray at an angle to the axis of a fisheye lens.
fn fisheye_radius([k1, k2, k3, k4]: &[f64; 4], angle: f64) -> f64 {
    let s = angle * angle;
    angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
}

fn radial([k1, k2, _, _, k3, k4, k5, k6]: &[f64; 8], square: f64) -> f64 {
    (1.0 + square * (k1 + square * (k2 + square * k3)))
        / (1.0 + square * (k4 + square * (k5 + square * k6)))
}
