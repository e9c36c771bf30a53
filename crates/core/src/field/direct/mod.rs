//! The equations with all observations in them, factorised at once: for any number of observations.
//!
//! Nested dissection cuts the grid into halves by a line of pixels; the halves are eliminated first, in
//! parallel, and the line last. The points are eliminated wherever a region holds more than a few of them, so
//! that the columns enter only the last and largest steps.
//!
//! An observation at a pixel's centre is carried by the variable of that pixel until it is eliminated. An
//! observation between pixels is carried by an additional variable z, with the terms
//! `2 a (s . y - z)^2 + 2 a (z - t)^2`: their minimum over z is `a (s . y - t)^2`, and the pixels around the
//! position can be eliminated in their usual order.

mod columns;
mod dense;
mod dissection;
mod elimination;
mod front;
mod spread;

use super::{Grid, Observations, Reach, Spread};
use dissection::{Dissection, Region};
use elimination::{Elimination, Room};
use faer::Mat;
use front::Front;
use lsdc_kernels::simd::Level;

/// A factorised field: solving for any combination of the columns costs almost nothing.
#[derive(Clone, Debug)]
pub(super) struct Direct {
    fronts: Vec<Front>,
    pixels: usize,
    /// Number of variables: pixels, and observations between them.
    variables: usize,
    moments: Mat<f64>,
    carriers: Vec<Carrier>,
}

/// The variable that carries an observation until the columns are introduced.
#[derive(Clone, Copy, Debug)]
struct Carrier {
    variable: u32,
    /// Weight of the variable against the target.
    weight: f64,
}

/// Fronts with more descendants share them among threads.
const FORK: usize = 16;

/// Observations by the variables that carry them.
struct Sites<'a> {
    seen: &'a Observations<'a>,
    carriers: Vec<Carrier>,
    /// One more than the observation that each pixel carries, or 0.
    on_pixel: Vec<u32>,
    /// Observations with variables of their own, in the order of these.
    between: Vec<u32>,
    /// These variables, sorted by the pixel of theirs that is eliminated first.
    beginning: Vec<u32>,
    /// Where those of each pixel start in the list, and its length.
    starts: Vec<u32>,
}

impl<'a> Sites<'a> {
    fn new(seen: &'a Observations<'a>, cuts: &Dissection) -> Self {
        let pixels = cuts.len();
        let mut sites = Self {
            seen,
            carriers: Vec::with_capacity(seen.taps.len()),
            on_pixel: vec![0; pixels],
            between: Vec::new(),
            beginning: Vec::new(),
            starts: vec![0; pixels + 1],
        };
        let mut beginning = Vec::new();
        for (i, (taps, &weight)) in seen.taps.iter().zip(seen.weights).enumerate() {
            let own = taps.single().filter(|&p| sites.on_pixel[p as usize] == 0);
            let carrier = if let Some(pixel) = own {
                sites.on_pixel[pixel as usize] = i as u32 + 1;
                Carrier {
                    variable: pixel,
                    weight,
                }
            } else {
                let variable = (pixels + sites.between.len()) as u32;
                let first = taps.iter().map(|(pixel, _)| pixel);
                let first = first.min_by_key(|&pixel| (cuts.turn(pixel), pixel));
                beginning.extend(first.map(|pixel| (pixel, variable)));
                sites.between.push(i as u32);
                Carrier {
                    variable,
                    weight: 2.0 * weight,
                }
            };
            sites.carriers.push(carrier);
        }
        beginning.sort_unstable();
        for &(pixel, _) in &beginning {
            sites.starts[pixel as usize + 1] += 1;
        }
        for pixel in 0..pixels {
            sites.starts[pixel + 1] += sites.starts[pixel];
        }
        sites.beginning = beginning
            .into_iter()
            .map(|(_, variable)| variable)
            .collect();
        sites
    }

    /// Pixels, and observations between them.
    fn variables(&self) -> usize {
        self.on_pixel.len() + self.between.len()
    }

    /// The observation that a variable carries.
    fn carried(&self, variable: u32) -> Option<usize> {
        match (variable as usize).checked_sub(self.on_pixel.len()) {
            None => (self.on_pixel[variable as usize] as usize).checked_sub(1),
            Some(place) => Some(self.between[place] as usize),
        }
    }

    /// The observations with variables of their own of which a pixel is the first to be eliminated.
    fn beginning_at(&self, pixel: u32) -> impl Iterator<Item = (u32, usize)> + '_ {
        let [start, end] = [0, 1].map(|next| self.starts[pixel as usize + next] as usize);
        self.beginning[start..end].iter().map(|&variable| {
            let place = variable as usize - self.on_pixel.len();
            (variable, self.between[place] as usize)
        })
    }
}

impl Direct {
    pub(super) fn new(grid: &Grid<'_>, seen: &Observations<'_>) -> Option<Self> {
        let pixels = grid.height * grid.width;
        let cuts = Dissection::new(grid.height, grid.width);
        let sites = Sites::new(seen, &cuts);
        let variables = sites.variables();
        let whole = Region::whole(grid.height, grid.width);
        let elimination = Elimination {
            grid,
            sites: &sites,
            cuts: &cuts,
            level: Level::here(),
        };
        let part = elimination.eliminate(whole, &mut Room::new(variables + seen.count))?;
        Some(Self {
            fronts: part.fronts,
            pixels,
            variables,
            moments: part.rest.matrix(0..seen.count, seen.count),
            carriers: sites.carriers,
        })
    }

    pub(super) fn moments(&self) -> &Mat<f64> {
        &self.moments
    }

    pub(super) fn extend(&self, x: &[f64]) -> Vec<f64> {
        self.substitute(&vec![0.0; self.variables], x)
    }

    pub(super) fn solve(&self, right: &[f64]) -> Vec<f64> {
        let columns = self.moments.ncols();
        let mut values = right.to_vec();
        values.resize(self.variables + columns, 0.0);
        for front in &self.fronts {
            front.forward(&mut values);
        }
        self.substitute(&values, &vec![0.0; columns])
    }

    /// What is left of the equations once they are triangular, from the last front to the first.
    fn substitute(&self, right: &[f64], columns: &[f64]) -> Vec<f64> {
        let mut values = vec![0.0; self.variables];
        let Some(last) = self.fronts.len().checked_sub(1) else {
            return Vec::new();
        };
        for (at, found) in self.descend_values(last, &[], right, columns) {
            let pixels = &self.fronts[at].eliminated;
            for (&pixel, value) in pixels.iter().zip(found) {
                values[pixel as usize] = value;
            }
        }
        values.truncate(self.pixels);
        values
    }

    /// The values of the variables of a front and its descendants, those that it eliminates first;
    /// `later` are those of the front that it is a half of.
    fn descend_values(
        &self,
        at: usize,
        later: &[f64],
        right: &[f64],
        columns: &[f64],
    ) -> Vec<(usize, Vec<f64>)> {
        let front = &self.fronts[at];
        let mut values = vec![0.0; front.eliminated.len()];
        values.extend(front.inherited.iter().map(|&place| later[place as usize]));
        if front.joined {
            values.extend_from_slice(columns);
        }
        front.backward(right, &mut values);
        let run = |half: usize| self.descend_values(half, &values, right, columns);
        let mut found = match front.halves(at, &self.fronts)[..] {
            [one, two] if front.descendants > FORK => {
                let (mut one, two) = rayon::join(|| run(one), || run(two));
                one.extend(two);
                one
            }
            [one, two] => {
                let mut one = run(one);
                one.extend(run(two));
                one
            }
            _ => Vec::new(),
        };
        found.push((at, values));
        found
    }
}
