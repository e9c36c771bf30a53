//! Collects the points of an image.

use super::depths::Sparse;
use crate::error::Error;
use crate::grid::pixel;
use crate::{Camera, Unit};
use lsdc_core::Observation;
use lsdc_core::cloud::{Viewpoint, visible};
use std::path::Path;

/// Collects the points of an image, and counts the points that are left out.
#[derive(Default)]
pub(super) struct SparseBuilder {
    size: (usize, usize),
    pub(super) found: Vec<Observation>,
    /// Identifiers of the points, if all have one.
    ids: Vec<u64>,
    all: usize,
    pub(super) ignored: usize,
    outside: usize,
    /// Number of points whose standard deviation is unknown, because it is not positive and finite, and the first of them.
    unknown_sigmas: usize,
    first_unknown: usize,
    viewpoint: Viewpoint,
}

impl SparseBuilder {
    /// Creates a builder for an image of this width and height.
    pub(super) fn new(size: (usize, usize)) -> Self {
        Self {
            size,
            ..Self::default()
        }
    }

    /// [`Self::new`] with capacity for `count` points.
    pub(super) fn with_capacity(size: (usize, usize), count: usize) -> Self {
        Self {
            found: Vec::with_capacity(count),
            ..Self::new(size)
        }
    }

    /// Marks the points as measured in the image, or as already filtered.
    pub(super) fn of_camera(mut self) -> Self {
        self.viewpoint = Viewpoint::Camera;
        self
    }

    /// Adds the point with an index in the file: its position (u, v), depth and standard deviation in metres.
    pub(super) fn add(&mut self, [u, v]: [f64; 2], depth: f64, sigma: Option<f64>, number: usize) {
        let is_positive = |value: f32| value > 0.0 && value.is_finite();
        let (depth, sigma) = (depth as f32, sigma.map(|sigma| sigma as f32));
        self.all += 1;
        if !is_positive(depth) {
            self.ignored += 1;
        } else if pixel([u, v], self.size).is_none() {
            self.outside += 1;
        } else {
            if !sigma.is_none_or(is_positive) {
                if self.unknown_sigmas == 0 {
                    self.first_unknown = number;
                }
                self.unknown_sigmas += 1;
            }
            let sigma = sigma.filter(|sigma| is_positive(*sigma));
            self.found.push(Observation { u, v, depth, sigma });
        }
    }

    /// [`Self::add`] with the identifier of the point in its model.
    pub(super) fn add_identified(
        &mut self,
        position: [f64; 2],
        depth: f64,
        sigma: Option<f64>,
        (number, id): (usize, u64),
    ) {
        let before = self.found.len();
        self.add(position, depth, sigma, number);
        if self.found.len() > before {
            self.ids.push(id);
        }
    }

    /// Projects a point of a cloud, in stored units, and adds it.
    pub(super) fn project(
        &mut self,
        camera: &Camera,
        point: [f64; 3],
        metres: f64,
        sigma: Option<f64>,
    ) {
        let number = self.all;
        self.viewpoint = Viewpoint::Cloud;
        if point.iter().any(|v| !v.is_finite()) {
            self.all += 1;
            self.ignored += 1;
            return;
        }
        if let Some((position, depth)) = camera.project(point.map(|v| v * metres)) {
            self.add(position, depth, sigma, number);
        } else {
            self.all += 1;
            self.outside += 1;
        }
    }

    /// Returns the points without hidden ones; `row` is the word for a point of the file in messages.
    pub(super) fn build(mut self, unit: Unit, guessed: bool, row: &str) -> Sparse {
        let visible = visible(&self.found, self.size, self.viewpoint);
        let hidden = visible.iter().filter(|visible| !**visible).count();
        let identified = !self.ids.is_empty() && self.ids.len() == self.found.len();
        retain(&mut self.found, &visible);
        let ids = identified.then(|| {
            retain(&mut self.ids, &visible);
            self.ids
        });
        let remark = (self.unknown_sigmas > 0).then(|| {
            format!(
                "{} points have no usable standard deviation; the fit's own noise is assumed for them; the first is \
                 {row} {}",
                self.unknown_sigmas, self.first_unknown
            )
        });
        Sparse {
            points: self.found.into_iter().collect(),
            ids,
            size: self.size,
            unit,
            guessed,
            ignored: self.ignored,
            outside: self.outside,
            hidden,
            remarks: remark.into_iter().collect(),
        }
    }

    /// Returns the error if no point is left.
    pub(super) fn no_points(&self, path: &Path, points: &str) -> Error {
        let (all, (width, height)) = (self.all, self.size);
        Error::format(
            path,
            format!(
                "none of its {all} {points} lies in the image of {width}x{height} with a positive \
                 depth"
            ),
        )
    }
}

/// Retains the items that `kept` marks, in order.
fn retain<T>(items: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    items.retain(|_| kept.next().copied().unwrap_or(true));
}
