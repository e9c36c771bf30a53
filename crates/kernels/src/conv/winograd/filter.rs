//! Weights in the frequency domain.

use super::{IN, SPECTRUM, transform};
use crate::simd::{Buffer, Kernel, Level, Shared, Vector};
use rayon::prelude::*;

/// The spectrum of a 3x3 filter bank, `[panel][frequency][channels][width]`, and a bias.
#[derive(Clone, Debug)]
pub(in crate::conv) struct Filter {
    pub(super) level: Level,
    pub(super) channels: usize,
    pub(super) outputs: usize,
    pub(super) dilation: usize,
    /// The width of a panel.
    pub(super) panel: usize,
    pub(super) spectrum: Buffer,
    /// Bias, padded to whole panels.
    pub(super) bias: Vec<f32>,
}

impl Filter {
    /// Transforms weights `[channels, 3, 3, outputs]`; an empty bias is 0.
    pub(in crate::conv) fn new(
        level: Level,
        weights: &[f32],
        (channels, outputs): (usize, usize),
        dilation: usize,
        bias: &[f32],
    ) -> Self {
        assert_eq!(weights.len(), 9 * channels * outputs);
        let panel = level.panel(outputs);
        let padded = outputs.next_multiple_of(panel);
        let mut spectrum = Buffer::zeros(SPECTRUM * channels * padded);
        let shared = Shared::new(&mut spectrum);
        (0..channels).into_par_iter().for_each(|channel| {
            let kernel = Transform {
                weights,
                channels,
                outputs,
                channel,
                panel,
                spectrum: shared,
            };
            // SAFETY: the length was asserted; each channel writes its own rows.
            unsafe { level.run(kernel) }
        });
        let mut bias = bias.to_vec();
        bias.resize(padded, 0.0);
        Self {
            level,
            channels,
            outputs,
            dilation,
            panel,
            spectrum,
            bias,
        }
    }
}

struct Transform<'a> {
    weights: &'a [f32],
    channels: usize,
    outputs: usize,
    channel: usize,
    panel: usize,
    spectrum: Shared<'a>,
}

impl Kernel for Transform<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        for o in (0..self.outputs).step_by(V::LANES) {
            // SAFETY: rows of the weights have `outputs` floats, those of the spectrum are padded.
            unsafe {
                let mut columns = [[V::splat(0.0); IN]; 3];
                for (x, column) in columns.iter_mut().enumerate() {
                    let mut taps = [V::splat(0.0); 3];
                    for (y, tap) in taps.iter_mut().enumerate() {
                        let row = self.channel * 9 + y * 3 + x;
                        let from = self.weights.as_ptr().add(row * self.outputs + o);
                        *tap = V::load_some(from, self.outputs - o);
                    }
                    *column = transform::filter(taps);
                }
                for i in 0..IN {
                    let row = transform::filter(transform::column(&columns, i));
                    for (j, value) in row.into_iter().enumerate() {
                        let row = (o / self.panel * SPECTRUM + i * IN + j) * self.channels;
                        let at = (row + self.channel) * self.panel + o % self.panel;
                        value.store(self.spectrum.at(at, V::LANES));
                    }
                }
            }
        }
    }
}
