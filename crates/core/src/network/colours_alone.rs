//! No network: a constant, and affinities from the colours alone.

use super::colours::affinities;
use super::{Basis, Network};
use crate::error::Error;

/// What takes the place of a network that is not there.
#[derive(Clone, Copy, Debug)]
pub struct ColoursAlone;

#[derive(Debug)]
struct Colours {
    image: Vec<f32>,
    size: (usize, usize),
}

impl Network for ColoursAlone {
    fn basis(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Basis>, Error> {
        Ok(Box::new(Colours {
            image: image.to_vec(),
            size,
        }))
    }
}

impl Basis for Colours {
    fn at(&self, _: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        vec![1.0; places.len()]
    }

    fn combine(&self, (height, width): (usize, usize), weights: &[f64]) -> Vec<f32> {
        vec![weights.first().map_or(0.0, |w| *w as f32); height * width]
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        (affinities(&self.image, self.size, None), self.size)
    }
}
