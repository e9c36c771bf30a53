//! The losses of the paper (section 3.4), at the pixels of a batch.

use super::affinities::step_neg_log_likelihood;
use super::compare::{ErrorWeights, compared};
use super::{LossConfig, Losses, TeacherOutput};
use crate::model::BasisNet;
use crate::ops::{Reweighting, joint, lstsq, reweighted};
use crate::sample::Batch;
use burn::tensor::{Int, Tensor, TensorData};
use lsdc_core::fit::{FitConfig, FitMethod};
use lsdc_files::error::{Error, Result};

/// Runs the network once and one fit per draw, and compares the fits with the depths of the batch, and the network with that of
/// a teacher if there is one.
pub fn losses(
    net: &BasisNet,
    batch: &Batch,
    teacher: Option<&TeacherOutput>,
    fit: &FitConfig,
    robust: Option<Reweighting>,
    config: &LossConfig,
) -> Losses {
    if fit.method == FitMethod::Field {
        return field_losses(net, batch, teacher, fit, config);
    }
    let [images, _] = batch.depths.dims();
    let points = batch.points;
    let draws = batch.draws.dims()[0] / images;
    let bases = net.bases(batch.images.clone(), batch.encoded.clone());
    let (bases, at_points) = bases.hidden_and_first(batch.size, &batch.pixels, points);
    let span = teacher.and_then(|teacher| teacher.span_loss(&bases, &batch.depths, config));

    let at_points = at_points.repeat_dim(0, draws);
    let functions = at_points.dims()[2];
    let mean = (config.mean > 0.0).then(|| {
        let first = TensorData::new(first_of(images, functions), [images, functions, 1]);
        let map = bases.combine(Tensor::from_data(first, &at_points.device()));
        up_to_scale(map.squeeze_dim(2), batch.depths.clone()) * config.mean
    });
    let (depths, draw) = (
        batch.measured.clone().repeat_dim(0, draws),
        batch.draws.clone(),
    );
    let solver = fit.solver();
    let (weights, field) = match (fit.method, robust) {
        (FitMethod::Joint, _) => {
            let edges = net.affinities(batch.images.clone(), batch.encoded.clone());
            let places = candidates(batch);
            let found = joint(at_points, depths, draw, edges.clone(), places, fit);
            let field = at_pixels(found.field, &batch.pixels);
            (found.weights, Some((field, edges)))
        }
        (_, None) => (lstsq(at_points, depths, draw, solver), None),
        (_, Some(settings)) => {
            let found = reweighted(at_points, depths, draw, solver, settings);
            (found.0, None)
        }
    };
    let weights = weights
        .reshape([draws, images, functions])
        .permute([1, 2, 0]);
    // [images, pixels, draws]
    let mut fitted = bases.combine(weights.clone());
    if let Some((field, _)) = &field {
        fitted = fitted + field.clone();
    }
    let flat = batch.weights.clone().map(|weights| weights.flatten(1, 2));
    let error_weights = ErrorWeights {
        fits: fit_weights(batch, config),
        pixels: flat.map(|weights| at_pixels(weights, &batch.pixels)),
    };
    let patches = (points, batch.patch);
    let mut losses = compared(fitted, &batch.depths, &error_weights, patches, config);
    let edges = field.map(|(_, edges)| affinity_losses(&edges, batch, teacher, config));
    let more = edges.into_iter().flatten().chain(span).chain(mean);
    losses.total = more.fold(losses.total, |sum, loss| sum + loss);
    if config.regularisation > 0.0 {
        losses.total = losses.total + weights.abs().mean() * config.regularisation;
    }
    losses
}

/// Returns weights `[images, functions, 1]` of the first function alone.
fn first_of(images: usize, functions: usize) -> Vec<f32> {
    let one = |i: usize| f32::from(u8::from(i.is_multiple_of(functions)));
    (0..images * functions).map(one).collect()
}

/// Returns the mean of absolute and root mean squared differences between the logarithms of maps and depths `[images, pixels]`,
/// without their mean, averaged over images; depths of 0 are unknown.
fn up_to_scale(maps: Tensor<2>, depths: Tensor<2>) -> Tensor<1> {
    let known = depths.clone().greater_elem(0.0).float();
    let counts = known.clone().sum_dim(1).clamp_min(1.0);
    let off = (maps.log() - depths.clamp_min(1e-6).log()) * known.clone();
    let mean = off.clone().sum_dim(1) / counts.clone();
    let off = (off - mean) * known;
    let absolute = off.clone().abs().sum_dim(1) / counts.clone();
    let squared = off.square().sum_dim(1) / counts;
    (absolute + (squared + 1e-8).sqrt()).mean()
}

/// Compares the depth map predicted by the backbone of a network with the depths of a batch, at the pixels of its points and
/// patches. The rest of the network is not run.
///
/// # Errors
/// The network has no backbone that predicts a depth map.
pub(super) fn map_losses(net: &BasisNet, batch: &Batch, config: &LossConfig) -> Result<Losses> {
    let map = net.map_at(batch.images.clone(), batch.size, &batch.pixels);
    let map = map.ok_or_else(map_of_backbone)?;
    let loss = up_to_scale(map, batch.depths.clone()) * config.mean;
    Ok(Losses::only(loss))
}

/// Returns the error for training a map without a backbone.
pub(super) fn map_of_backbone() -> Error {
    Error::config("`train.part = \"map\"` is for networks whose backbone predicts a map of depth")
        .hint("set `preset = \"lite\"`")
}

/// Returns the losses of a field without basis functions, at every pixel; basis functions are not computed.
pub(super) fn field_losses(
    net: &BasisNet,
    batch: &Batch,
    teacher: Option<&TeacherOutput>,
    fit: &FitConfig,
    config: &LossConfig,
) -> Losses {
    let [images, ..] = batch.maps.dims();
    let points = batch.points;
    let draws = batch.draws.dims()[0] / images;
    let edges = net.affinities(batch.images.clone(), batch.encoded.clone());
    let device = edges.device();
    let mut losses = if config.l1 + config.l2 + config.rmse + config.berhu + config.gradient > 0.0 {
        let found = joint(
            Tensor::zeros([draws * images, points, 1], &device),
            batch.measured.clone().repeat_dim(0, draws),
            batch.draws.clone(),
            edges.clone(),
            candidates(batch),
            &FitConfig {
                joint: fit.joint.alone(),
                ..*fit
            },
        );
        compared_maps(found.field, batch, config)
    } else {
        Losses::only(Tensor::zeros([1], &device))
    };
    let more = affinity_losses(&edges, batch, teacher, config).into_iter();
    losses.total = more.fold(losses.total, |sum, loss| sum + loss);
    losses
}

/// Compares predicted depths `[draws * images, height, width]` with those of a batch. The errors are those of the first map;
/// the losses of all maps are summed.
pub fn depth_losses(
    depth: Tensor<3>,
    others: impl IntoIterator<Item = Tensor<3>>,
    batch: &Batch,
    config: &LossConfig,
) -> Losses {
    let whole = |depth: Tensor<3>| compared_maps(depth.flatten(1, 2), batch, config);
    let mut losses = whole(depth);
    for other in others {
        losses.total = losses.total + whole(other).total;
    }
    losses
}

/// Compares depths `[draws * images, height * width]` with those of the whole images of a batch.
fn compared_maps(depths: Tensor<2>, batch: &Batch, config: &LossConfig) -> Losses {
    let [images, height, width] = batch.maps.dims();
    let (draws, pixels) = (depths.dims()[0] / images, height * width);
    let depths = depths.reshape([draws, images, pixels]).permute([1, 2, 0]);
    let maps = batch.maps.clone().reshape([images, pixels]);
    let weights = batch.weights.clone();
    let weights = ErrorWeights {
        fits: fit_weights(batch, config),
        pixels: weights.map(|weights| weights.reshape([images, pixels, 1])),
    };
    compared(depths, &maps, &weights, (0, (height, width)), config)
}

/// Returns the weighted losses of the affinities themselves, if their weights are above 0.
fn affinity_losses(
    edges: &Tensor<4>,
    batch: &Batch,
    teacher: Option<&TeacherOutput>,
    config: &LossConfig,
) -> Vec<Tensor<1>> {
    let measured = (config.affinities > 0.0)
        .then(|| step_neg_log_likelihood(edges, &batch.maps) * config.affinities);
    let imitated = teacher.and_then(|teacher| teacher.affinity_loss(edges, config));
    measured.into_iter().chain(imitated).collect()
}

/// Returns the pixels of the candidate points of each image.
fn candidates(batch: &Batch) -> Vec<Vec<u32>> {
    let lists = batch.pixels.iter();
    lists.map(|list| list[..batch.points].to_vec()).collect()
}

/// Returns the weights of the errors of each fit, `[images, 1, draws]`; `None` if they are equal.
fn fit_weights(batch: &Batch, config: &LossConfig) -> Option<Tensor<3>> {
    if config.balance == 0.0 {
        return None;
    }
    let images = batch.maps.dims()[0];
    let problems = batch.draws.dims()[0];
    let counts = batch.draws.clone().sum_dim(1) / batch.points as f64;
    let shares = counts.clamp_min(1e-6).powf_scalar(config.balance);
    let shares = shares.reshape([problems / images, images, 1]);
    Some(shares.permute([1, 2, 0]))
}

/// Returns fields `[draws * images, height * width]` at pixels of each image: `[images, pixels, draws]`.
fn at_pixels(field: Tensor<2>, pixels: &[Vec<u32>]) -> Tensor<3> {
    let [problems, _] = field.dims();
    let (images, count) = (pixels.len(), pixels.first().map_or(0, Vec::len));
    let draws = problems / images;
    let places: Vec<i32> = pixels.iter().flatten().map(|&p| p as i32).collect();
    let places = TensorData::new(places, [images, count]);
    let places = Tensor::<2, Int>::from_data(places, &field.device()).repeat_dim(0, draws);
    let values = field.gather(1, places);
    values.reshape([draws, images, count]).permute([1, 2, 0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;

    #[test]
    fn maps_are_compared_up_to_scale_where_depth_is_known() {
        let device = Device::flex();
        let tensor = |values: [[f32; 4]; 2]| Tensor::<2>::from_data(values, &device);
        let loss = |maps, depths| up_to_scale(tensor(maps), tensor(depths)).into_scalar::<f32>();
        let depths = [[1.0, 2.0, 4.0, 0.0], [3.0, 3.0, 3.0, 3.0]];
        let alike = [[0.5, 1.0, 2.0, 9.0], [7.0, 7.0, 7.0, 7.0]];
        assert!(loss(alike, depths) < 1e-3);
        // In the first image, logarithms differ by 1, 0 and 2, or -1, 0 and 1 without their mean. The mean absolute difference
        // is 2 / 3, and the root mean squared difference is its square root.
        let e = std::f32::consts::E;
        let off = [[e, 2.0, 4.0 * e * e, 1.0], [1.0, 1.0, 1.0, 1.0]];
        let expected = f32::midpoint(2.0 / 3.0, (2.0_f32 / 3.0).sqrt());
        assert!((loss(off, depths) - expected).abs() < 1e-3);
    }
}
