//! No network: a constant, and affinities from the colours alone.

use super::colours::affinities;
use super::{Basis, Forward, Network};
use crate::error::Error;

/// What takes the place of a network that is not there.
#[derive(Clone, Copy, Debug)]
pub struct ColourAffinity;

#[derive(Debug)]
struct Colours {
    image: Vec<f32>,
    size: (usize, usize),
}

impl Network for ColourAffinity {
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error> {
        Ok(Box::new(Colours {
            image: image.to_vec(),
            size,
        }))
    }
}

impl Forward for Colours {
    fn basis(&self) -> Box<dyn Basis> {
        Box::new(Constant)
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        (affinities(&self.image, self.size, None), self.size)
    }
}

#[derive(Debug)]
struct Constant;

impl Basis for Constant {
    fn at(&self, _: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        vec![1.0; places.len()]
    }

    fn combine(&self, (height, width): (usize, usize), weights: &[f64]) -> Vec<f32> {
        vec![weights.first().map_or(0.0, |w| *w as f32); height * width]
    }
}
