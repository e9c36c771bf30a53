//! Data parallelism over several devices: each computes the gradients of its share of the images with a copy of the network.
//! Their sum is the gradient of the whole batch, except for means over pixels with missing depths, which are taken within each
//! share. Batch normalisation sees one share at a time, and its running statistics follow the first share.

use super::step::UnreadLosses;
use crate::sample::Batch;
use burn::module::Module;
use burn::optim::{GradientsAccumulator, GradientsParams};
use burn::tensor::Device;
use lsdc_files::error::{Cause, Error, Result};

/// Returns the gradients of all shares on the device of the network, and the losses of the whole batch.
///
/// `compute` returns those of one share, with the loss multiplied by a factor. Shares are summed in order, so that equal shares
/// give identical results.
pub(super) fn gradients<M: Module>(
    net: &M,
    shares: &[Batch],
    compute: impl Fn(&M, &Batch, f64) -> Result<(GradientsParams, UnreadLosses)> + Sync,
) -> Result<(GradientsParams, UnreadLosses)> {
    let images = |batch: &Batch| batch.pixels.len() as f64;
    let all: f64 = shares.iter().map(images).sum();
    let part = |batch: &Batch| images(batch) / all;
    let [first, others @ ..] = shares else {
        return Err(Error::shape("a step needs a batch"));
    };
    let compute = &compute;
    let results = std::thread::scope(|scope| {
        let others: Vec<_> = others
            .iter()
            .map(|batch| {
                let replica = replica(net, &batch.images.device());
                scope.spawn(move || compute(&replica, batch, part(batch)))
            })
            .collect();
        let mut results = vec![compute(net, first, part(first))];
        results.extend(others.into_iter().map(|thread| {
            thread.join().unwrap_or_else(|_| {
                Err(Error::new(Cause::Fit, "a device failed in a step")
                    .hint("training goes on from the last checkpoint, with `--resume`"))
            })
        }));
        results.into_iter().collect::<Result<Vec<_>>>()
    })?;
    let device = first.depths.device().inner();
    let mut sum = GradientsAccumulator::new();
    let mut parts = Vec::with_capacity(shares.len());
    for (share, (gradients, losses)) in shares.iter().zip(results) {
        sum.accumulate(net, gradients.to_device(&device, net));
        parts.push((losses, part(share)));
    }
    let losses = UnreadLosses::of_parts(parts);
    let losses = losses.ok_or_else(|| Error::shape("a step needs a batch"))?;
    Ok((sum.grads(), losses))
}

/// Copies a network to an autodiff device. Clones, and burn's forks, share running statistics; a copy without gradients has its
/// own.
fn replica<M: Module>(net: &M, device: &Device) -> M {
    net.valid().to_device(&device.clone().inner()).train()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{BasisNet, InitNetwork as _};
    use crate::training::{LossConfig, StepLosses, losses};
    use burn::module::{ModuleVisitor, Param};
    use burn::tensor::{Tensor, TensorData};
    use lsdc_core::fit::FitConfig;
    use lsdc_core::network::{ExtractorConfig, NetworkConfig};
    use lsdc_rng::Rng;
    use std::ops::Range;

    const SIZE: (usize, usize) = (12, 16);
    const PIXELS: usize = SIZE.0 * SIZE.1;

    /// Returns a part of three images in which every pixel is a point.
    fn batch(images: Range<usize>, device: &Device) -> Batch {
        let mut rng = Rng::stream(5, &[]);
        let colours: Vec<f32> = (0..3 * 3 * PIXELS).map(|_| rng.normal()).collect();
        let depths: Vec<f32> = (0..3 * PIXELS).map(|_| rng.range(1.0, 4.0)).collect();
        let count = images.len();
        let part =
            |values: &[f32], size: usize| values[images.start * size..images.end * size].to_vec();
        let colours = TensorData::new(part(&colours, 3 * PIXELS), [count, SIZE.0, SIZE.1, 3]);
        let depths = part(&depths, PIXELS);
        let maps = TensorData::new(depths.clone(), [count, SIZE.0, SIZE.1]);
        Batch {
            images: Tensor::from_data(colours, device),
            encoded: None,
            size: SIZE,
            pixels: vec![(0..PIXELS as u32).collect(); count],
            measured: Tensor::from_data(TensorData::new(depths.clone(), [count, PIXELS]), device),
            depths: Tensor::from_data(TensorData::new(depths, [count, PIXELS]), device),
            maps: Tensor::from_data(maps, device),
            weights: None,
            points: PIXELS,
            draws: Tensor::ones([count, PIXELS], device),
            patch: (0, 0),
        }
    }

    struct Read<'a>(&'a GradientsParams, Vec<f32>);

    impl ModuleVisitor for Read<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let gradient = self.0.get::<D>(param.id);
            let values = gradient.map(Tensor::into_data);
            self.1
                .extend(values.iter().flat_map(|data| data.iter::<f32>()));
        }
    }

    /// The values of all tensors, including running statistics.
    struct Values(Vec<f32>);

    impl ModuleVisitor for Values {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0.extend(param.val().into_data().iter::<f32>());
        }
    }

    fn net(device: &Device) -> BasisNet {
        let config = NetworkConfig {
            extractor: ExtractorConfig {
                sharpening: 1,
                ..ExtractorConfig::slim()
            },
            hidden: vec![24],
            bases: 16,
            affinities: 0,
            ..NetworkConfig::sharp()
        };
        config.init(0, device).unwrap()
    }

    fn run(net: &BasisNet, shares: &[Batch]) -> (Vec<f32>, StepLosses) {
        let loss = LossConfig {
            rmse: 1.0,
            gradient: 0.0,
            ..LossConfig::default()
        };
        let fit = FitConfig {
            ridge: 1e-2,
            ..FitConfig::default()
        };
        let (found, step) = gradients(net, shares, |net, batch, part| {
            let losses = losses(net, batch, None, &fit, None, &loss);
            let step = UnreadLosses::of(&losses);
            let gradients = (losses.total * part).backward();
            Ok((GradientsParams::from_grads(gradients, net), step))
        })
        .unwrap();
        let mut read = Read(&found, Vec::new());
        net.visit(&mut read);
        (read.1, UnreadLosses::read(vec![step]).unwrap()[0])
    }

    #[test]
    fn shares_add_up_to_the_batch() {
        let device = Device::flex().autodiff();
        let net = net(&device).freeze_statistics();
        let (whole, step) = run(&net, &[batch(0..3, &device)]);
        let (parts, divided) = run(&net, &[batch(0..2, &device), batch(2..3, &device)]);
        assert!(whole.len() > 1000 && whole.len() == parts.len());
        let largest = whole.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(largest > 1e-3);
        for (a, b) in whole.iter().zip(&parts) {
            assert!((a - b).abs() < 1e-4 * largest, "{a} {b}");
        }
        for (a, b) in [
            (step.loss, divided.loss),
            (step.l1, divided.l1),
            (step.l2, divided.l2),
        ] {
            assert!((a - b).abs() < 1e-5 * a, "{a} {b}");
        }
    }

    #[test]
    fn running_statistics_follow_the_first_share() {
        let device = Device::flex().autodiff();
        let after = |shares: &[Batch]| {
            let net = net(&device);
            run(&net, shares);
            let mut values = Values(Vec::new());
            net.visit(&mut values);
            values.0
        };
        let alone = after(&[batch(0..2, &device)]);
        assert_eq!(after(&[batch(0..2, &device), batch(2..3, &device)]), alone);
        assert_ne!(after(&[batch(2..3, &device)]), alone);
    }
}
