//! Every kernel against the kernels of the CPU or plain loops in f64, at sizes around those of tiles.

use crate::device::Pending;
use crate::head::{Features, Head};
use crate::kernel::Activation;
use crate::plan::{Launches, Map, Place, Recorder};
use crate::traffic::Part;
use crate::weights::{GpuLayer, Packer, quads};
use crate::{Adapter, Gpu};
use lsdc_core::bilinear::neighbours;
use lsdc_core::network::{
    Executor as _, FirstFunction, HeadExecutor as _, HeadWeights, LAYER_EPSILON, LinearWeights,
    MAX_LOG_DEPTH, Prepare as _, TokenLayer, codes,
};
use lsdc_kernels::attention::gelu;
use lsdc_kernels::conv::{ConvSpec, Layer};
use lsdc_kernels::simd::{Level, Scratch, Tail};
use lsdc_rng::Rng;
use wgpu::{Buffer, BufferDescriptor, BufferUsages};

fn gpu() -> Option<Gpu> {
    let gpu = Gpu::open(Adapter::Best).ok();
    let required = std::env::var_os("LSDC_REQUIRE_GPU").is_some();
    assert!(gpu.is_some() || !required, "there is no adapter");
    gpu
}

fn random(count: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::stream(0, &["kernels", name]);
    (0..count).map(|_| rng.normal()).collect()
}

/// A map `[height, width, channels]` on the CPU.
#[derive(Clone)]
struct HostMap {
    values: Vec<f32>,
    size: (usize, usize),
    channels: usize,
}

impl HostMap {
    fn random(size: (usize, usize), channels: usize, name: &str) -> Self {
        Self {
            values: random(size.0 * size.1 * channels, name),
            size,
            channels,
        }
    }

    /// Filled up to quads of channels.
    fn padded(&self) -> Vec<f32> {
        let pixels = self.values.chunks_exact(self.channels);
        let padded = pixels.flat_map(|pixel| {
            let padding = 4 * quads(self.channels) - self.channels;
            pixel
                .iter()
                .copied()
                .chain(std::iter::repeat_n(0.0, padding))
        });
        padded.collect()
    }

    fn at(&self, y: usize, x: usize, channel: usize) -> f64 {
        self.values[(y * self.size.1 + x) * self.channels + channel].into()
    }

    fn between(&self, (row, column): (f64, f64), from: (usize, usize), channel: usize) -> f64 {
        let (top, bottom, v) = neighbours(row, from.0, self.size.0);
        let (left, right, u) = neighbours(column, from.1, self.size.1);
        let along =
            |y: usize| self.at(y, left, channel) * (1.0 - u) + self.at(y, right, channel) * u;
        along(top) * (1.0 - v) + along(bottom) * v
    }

    fn enlarged(&self, size: (usize, usize)) -> Self {
        let pixels = (0..size.0).flat_map(|y| (0..size.1).map(move |x| (y as f64, x as f64)));
        let values = pixels.flat_map(|place| {
            (0..self.channels).map(move |channel| self.between(place, size, channel) as f32)
        });
        Self {
            values: values.collect(),
            size,
            channels: self.channels,
        }
    }

    fn plus(mut self, other: &Self) -> Self {
        let pairs = self.values.iter_mut().zip(&other.values);
        pairs.for_each(|(sum, value)| *sum += value);
        self
    }

    fn rectified(mut self) -> Self {
        self.values
            .iter_mut()
            .for_each(|value| *value = value.max(0.0));
        self
    }
}

/// A convolution on both.
struct Convolution {
    sizes: [usize; 3],
    spec: ConvSpec,
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Convolution {
    fn new(sizes: [usize; 3], spec: ConvSpec, has_bias: bool) -> Self {
        let [outputs, channels, taps] = sizes;
        let count = outputs * channels * taps * taps;
        Self {
            sizes,
            spec,
            weights: random(count, "weights"),
            bias: random(if has_bias { outputs } else { 0 }, "bias"),
        }
    }

    fn on_gpu(&self, packer: &Packer) -> GpuLayer {
        packer.layer(&self.weights, self.sizes, &self.bias, self.spec)
    }

    fn on_cpu(&self, x: &HostMap) -> HostMap {
        let layer = Layer::new(
            Level::here(),
            &self.weights,
            self.sizes,
            &self.bias,
            self.spec,
        );
        let size = [1, x.size.0, x.size.1];
        let out = layer.shape(size).out();
        let mut values = vec![0.0; out.0 * out.1 * self.sizes[0]];
        let scratch = Scratch::default();
        layer.apply(&x.values, size, Tail::default(), &scratch, &mut values);
        HostMap {
            values,
            size: out,
            channels: self.sizes[0],
        }
    }
}

fn storage(gpu: &Gpu, values: &[f32]) -> Buffer {
    let buffer = gpu.device().create_buffer(&BufferDescriptor {
        label: None,
        size: 4 * values.len().max(4) as u64,
        usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    gpu.upload(Part::Preparation, &buffer, 0, bytemuck::cast_slice(values));
    buffer
}

/// What a GPU makes of maps.
fn computed(
    gpu: &Gpu,
    packer: Packer,
    inputs: &[&HostMap],
    channels: usize,
    record: impl FnOnce(&Recorder, &[Map]) -> Map,
) -> HostMap {
    let recorder = Recorder::default();
    let maps = inputs
        .iter()
        .map(|x| recorder.map(x.size, quads(x.channels)));
    let maps: Vec<Map> = maps.collect();
    let output = record(&recorder, &maps);
    let weights = storage(gpu, &packer.into_values());
    let launches = Launches::new(gpu, recorder, &weights).unwrap();
    for (map, values) in maps.iter().zip(inputs) {
        let (offset, _) = map.place().bytes();
        let values = values.padded();
        gpu.upload(
            Part::Network,
            &launches.maps,
            offset,
            bytemuck::cast_slice(&values),
        );
    }
    let place = output.place();
    let (offset, bytes) = place.bytes();
    let staging = gpu.staging(bytes);
    let submitted = gpu.submit(Part::Network, |encoder| {
        let count = launches.encode(encoder, 0..launches.len());
        encoder.copy_buffer_to_buffer(&launches.maps, offset, &staging, 0, bytes);
        count
    });
    let values = gpu.wait(
        Part::Network,
        Pending::new(staging, bytes as usize / 4, submitted),
    );
    gpu.check().unwrap();
    let pixels = values.chunks_exact(4 * place.quads);
    HostMap {
        values: pixels
            .flat_map(|pixel| pixel[..channels].to_vec())
            .collect(),
        size: (place.height, place.width),
        channels,
    }
}

fn agree(what: &str, found: &[f32], expected: &[f32]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let scale = expected.iter().fold(1e-30, |m: f32, v| m.max(v.abs()));
    let pairs = found.iter().zip(expected);
    let worst = pairs.fold(0.0, |m: f32, (a, b)| m.max((a - b).abs())) / scale;
    assert!(worst < 1e-5, "{what}: {worst:.1e}");
}

#[test]
fn convolutions_agree() {
    let Some(gpu) = gpu() else { return };
    let wide = ConvSpec {
        stride: 2,
        ..ConvSpec::pointwise()
    };
    let three = [ConvSpec::same(1), ConvSpec::same(2), ConvSpec::halving()];
    let mut cases = Vec::new();
    for (size, channels) in [
        ((1, 1), [3, 5]),
        ((2, 5), [16, 32]),
        ((33, 20), [17, 33]),
        ((31, 18), [70, 130]),
        ((150, 140), [8, 16]),
        ((90, 80), [12, 64]),
    ] {
        cases.extend(three.map(|spec| (size, channels, 3, spec)));
        cases.extend([ConvSpec::pointwise(), wide].map(|spec| (size, channels, 1, spec)));
    }
    for (i, (size, [channels, outputs], taps, spec)) in cases.into_iter().enumerate() {
        let layer = Convolution::new([outputs, channels, taps], spec, i % 3 > 0);
        let x = HostMap::random(size, channels, "x");
        let mut expected = layer.on_cpu(&x);
        let skip = HostMap::random(expected.size, outputs, "skip");
        let relu = i % 4 == 3;
        let skips = i % 2 == 0;
        if skips {
            expected = expected.plus(&skip);
        }
        if relu {
            expected = expected.rectified();
        }
        let packer = Packer::default();
        let prepared = layer.on_gpu(&packer);
        let found = computed(&gpu, packer, &[&x, &skip], outputs, |recorder, maps| {
            recorder.layer(&prepared, &maps[0], skips.then_some(&maps[1]), relu)
        });
        let what = format!("{size:?} {channels} {outputs} {taps} {spec:?}");
        agree(&what, &found.values, &expected.values);
    }
}

#[test]
fn separable_convolutions_agree() {
    let Some(gpu) = gpu() else { return };
    for (size, [inner, outputs], taps, stride) in [
        ((1, 1), [8, 5], 3, 1),
        ((9, 14), [96, 24], 3, 2),
        ((15, 11), [30, 40], 5, 1),
        ((40, 33), [144, 70], 5, 2),
    ] {
        for (skips, has_bias) in [(true, true), (false, false)] {
            let spec = ConvSpec::depthwise(taps, stride);
            let depthwise = Convolution::new([inner, 1, taps], spec, has_bias);
            let pointwise = Convolution::new([outputs, inner, 1], ConvSpec::pointwise(), has_bias);
            let x = HostMap::random(size, inner, "x");
            let mut expected = pointwise.on_cpu(&depthwise.on_cpu(&x).rectified());
            let skip = HostMap::random(expected.size, outputs, "skip");
            if skips {
                expected = expected.plus(&skip);
            }
            let packer = Packer::default();
            let layers = [depthwise.on_gpu(&packer), pointwise.on_gpu(&packer)];
            let found = computed(&gpu, packer, &[&x, &skip], outputs, |recorder, maps| {
                let skip = skips.then_some(&maps[1]);
                recorder.separable(&layers[0], &layers[1], &maps[0], skip)
            });
            agree(
                &format!("{size:?} {inner} {taps}"),
                &found.values,
                &expected.values,
            );
        }
    }
}

#[test]
fn sums_with_enlarged_maps_agree() {
    let Some(gpu) = gpu() else { return };
    for (coarse, fine, [channels, outputs]) in [
        ((1, 1), (4, 3), [6, 7]),
        ((5, 7), (10, 13), [24, 16]),
        ((19, 14), (57, 76), [96, 64]),
    ] {
        let layer = Convolution::new([outputs, channels, 1], ConvSpec::pointwise(), false);
        let packer = Packer::default();
        let prepared = layer.on_gpu(&packer);
        let (x, map) = (
            HostMap::random(coarse, channels, "x"),
            HostMap::random(fine, outputs, "map"),
        );
        let expected = map.clone().plus(&layer.on_cpu(&x).enlarged(fine));
        let found = computed(&gpu, packer, &[&x, &map], outputs, |recorder, maps| {
            recorder.plus_enlarged_layer(maps[1].clone(), &prepared, &maps[0])
        });
        agree("layer", &found.values, &expected.values);

        let packer = Packer::default();
        let prepared = layer.on_gpu(&packer);
        let (x, map) = (
            HostMap::random(fine, channels, "x"),
            HostMap::random(coarse, outputs, "map"),
        );
        let expected = layer.on_cpu(&x).plus(&map.enlarged(fine));
        let found = computed(&gpu, packer, &[&x, &map], outputs, |recorder, maps| {
            recorder.layer_plus_enlarged(&prepared, &maps[0], &maps[1])
        });
        agree("map", &found.values, &expected.values);

        let found = computed(
            &gpu,
            Packer::default(),
            &[&x, &map],
            outputs,
            |recorder, maps| recorder.enlarged(&maps[1], &maps[0]),
        );
        agree("enlarged", &found.values, &map.enlarged(fine).values);
    }
}

/// Rows with mean 0 and variance 1, then gain and shift, in f64.
fn normalised(x: &HostMap, (gain, shift): (&[f32], &[f32])) -> Vec<f64> {
    let rows = x.values.chunks_exact(x.channels);
    rows.flat_map(|row| {
        let row: Vec<f64> = row.iter().copied().map(f64::from).collect();
        let mean = row.iter().sum::<f64>() / row.len() as f64;
        let squares: f64 = row.iter().map(|v| (v - mean).powi(2)).sum();
        let scale = 1.0 / (squares / row.len() as f64 + f64::from(LAYER_EPSILON)).sqrt();
        let tails = gain.iter().zip(shift);
        let values = row.iter().zip(tails);
        let value =
            |(v, (g, s)): (&f64, (&f32, &f32))| (v - mean) * scale * f64::from(*g) + f64::from(*s);
        values.map(value).collect::<Vec<f64>>()
    })
    .collect()
}

#[test]
fn token_layers_agree() {
    let Some(gpu) = gpu() else { return };
    // As many tokens as make tiles of every height.
    for (tokens, [inputs, outputs], half) in [
        (1, [8, 4], false),
        (50, [20, 36], true),
        (769, [64, 96], false),
        (769, [96, 64], true),
        (2500, [16, 256], true),
    ] {
        let rounded = |value: f32| half::f16::from_f32(value).to_f32();
        let draws = random(inputs * outputs, "weights").into_iter();
        let weights: Vec<f32> = draws.map(|v| if half { rounded(v) } else { v }).collect();
        let [bias, scale] = ["bias", "scale"].map(|name| random(outputs, name));
        let [gain, shift] = ["gain", "shift"].map(|name| random(inputs, name));
        let mut x = HostMap::random((1, tokens), inputs, "x");
        // A mean that is not 0, and channels much larger than the others.
        x.values.iter_mut().for_each(|value| *value += 0.5);
        x.values
            .iter_mut()
            .step_by(7)
            .for_each(|value| *value *= 20.0);
        let skip = HostMap::random((1, tokens), outputs, "skip");
        for norms in [false, true] {
            let rows = if norms {
                normalised(&x, (&gain, &shift))
            } else {
                x.values.iter().copied().map(f64::from).collect()
            };
            let products = rows.chunks_exact(inputs).flat_map(|row| {
                let of = |o: usize| {
                    let own = &weights[o * inputs..][..inputs];
                    let terms = row.iter().zip(own).map(|(x, w)| x * f64::from(*w));
                    terms.sum::<f64>() + f64::from(bias[o])
                };
                (0..outputs).map(of).collect::<Vec<f64>>()
            });
            let products: Vec<f64> = products.collect();
            let packer = Packer::default();
            let layer = TokenLayer {
                weights: &weights,
                bias: &bias,
                scale: Some(&scale),
            };
            let scaled = packer.token_layer(&layer);
            let plain = packer.token_layer(&TokenLayer {
                scale: None,
                ..layer
            });
            assert_eq!(scaled.half, half);
            let norm = packer.norm((&gain, &shift));
            let norm = norms.then_some(norm);
            let packed = packer.into_values();
            let found = |record: &dyn Fn(&Recorder, &[Map]) -> Map| {
                let packer = Packer::default();
                packer.rows(&packed, packed.len(), 0);
                computed(&gpu, packer, &[&x, &skip], outputs, record).values
            };
            let sums = products.iter().zip(scale.iter().cycle()).zip(&skip.values);
            let expected: Vec<f32> = sums
                .map(|((v, s), skip)| (v * f64::from(*s) + f64::from(*skip)) as f32)
                .collect();
            let what = format!("{tokens} tokens, {inputs} to {outputs}, {norms}");
            let sum = found(&|recorder, maps| {
                let skip = Some(&maps[1]);
                recorder.token_layer(&scaled, &maps[0], norm, skip, Activation::None)
            });
            agree(&what, &sum, &expected);

            let mut expected: Vec<f32> = products.iter().map(|v| *v as f32).collect();
            gelu(Level::here(), &mut expected);
            let activated = found(&|recorder, maps| {
                recorder.token_layer(&plain, &maps[0], norm, None, Activation::Gelu)
            });
            agree(&format!("GELU, {what}"), &activated, &expected);
        }
    }
}

#[test]
fn attention_is_the_weighted_mean_of_values() {
    let Some(gpu) = gpu() else { return };
    for (tokens, heads, depth, scale) in [
        (1, 1, 4, 1.0),
        (5, 2, 8, 1.0),
        (32, 3, 64, 1.0),
        // Of which one score decides.
        (33, 6, 64, 4.0),
        (150, 2, 96, 0.3),
    ] {
        let width = heads * depth;
        let mut rows = HostMap::random((1, tokens), 3 * width, "rows");
        rows.values.iter_mut().for_each(|value| *value *= scale);
        let mut expected = vec![0.0; tokens * width];
        for (query, head) in (0..tokens).flat_map(|query| (0..heads).map(move |h| (query, h))) {
            let at = |token: usize, which: usize, k: usize| {
                rows.at(0, token, which * width + head * depth + k)
            };
            let score = |key: usize| {
                let terms = (0..depth).map(|k| at(query, 0, k) * at(key, 1, k));
                terms.sum::<f64>() / (depth as f64).sqrt()
            };
            let scores: Vec<f64> = (0..tokens).map(score).collect();
            let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let shares: Vec<f64> = scores.iter().map(|score| (score - most).exp()).collect();
            let total: f64 = shares.iter().sum();
            for k in 0..depth {
                let terms = shares.iter().enumerate();
                let sum: f64 = terms.map(|(key, share)| share * at(key, 2, k)).sum();
                expected[query * width + head * depth + k] = (sum / total) as f32;
            }
        }
        let found = computed(
            &gpu,
            Packer::default(),
            &[&rows],
            width,
            |recorder, maps| recorder.attention(&maps[0], quads(depth)),
        );
        agree(
            &format!("{tokens} tokens, {heads} heads"),
            &found.values,
            &expected,
        );
    }
}

#[test]
fn features_of_tokens_agree() {
    let Some(gpu) = gpu() else { return };
    let (size, channels) = ((3, 5), 36);
    let taps = ["one", "two", "three"].map(|name| HostMap::random((1, 16), channels, name));
    let [gain, shift] = ["gain", "shift"].map(|name| random(channels, name));
    let rows = taps.each_ref().map(|tap| normalised(tap, (&gain, &shift)));
    // Without the class token, which is the first.
    let of_patch = |patch: usize| {
        let of_tap = move |rows: &Vec<f64>| rows[patch * channels..][..channels].to_vec();
        rows.iter()
            .flat_map(of_tap)
            .map(|v| v as f32)
            .collect::<Vec<f32>>()
    };
    let expected: Vec<f32> = (1..16).flat_map(of_patch).collect();
    let packer = Packer::default();
    let norm = packer.norm((&gain, &shift));
    let inputs: Vec<&HostMap> = taps.iter().collect();
    let found = computed(&gpu, packer, &inputs, 3 * channels, |recorder, maps| {
        let places: Vec<Place> = maps.iter().map(|map| map.place().after(1, size)).collect();
        recorder.features(&places, size, norm)
    });
    assert_eq!(found.size, size);
    agree("features", &found.values, &expected);
}

#[test]
fn maps_in_other_forms_agree() {
    let Some(gpu) = gpu() else { return };
    let packer = Packer::default;
    for (from, to) in [
        ((1, 1), (2, 3)),
        ((5, 7), (9, 13)),
        ((6, 8), (84, 112)),
        ((4, 4), (4, 4)),
    ] {
        let x = HostMap::random(from, 8, "x");
        let place = |i: usize, from: usize, to: usize| {
            i as f64 * (from - 1) as f64 / (to - 1).max(1) as f64
        };
        let pixels = (0..to.0).flat_map(|i| (0..to.1).map(move |j| (i, j)));
        let expected = pixels.flat_map(|(i, j)| {
            let (row, column) = (place(i, from.0, to.0), place(j, from.1, to.1));
            let (top, left) = (row as usize, column as usize);
            let (bottom, right) = ((top + 1).min(from.0 - 1), (left + 1).min(from.1 - 1));
            let (v, u) = (row.fract(), column.fract());
            let x = &x;
            (0..8).map(move |c| {
                let upper = x.at(top, left, c) * (1.0 - u) + x.at(top, right, c) * u;
                let lower = x.at(bottom, left, c) * (1.0 - u) + x.at(bottom, right, c) * u;
                (upper * (1.0 - v) + lower * v) as f32
            })
        });
        let expected: Vec<f32> = expected.collect();
        let found = computed(&gpu, packer(), &[&x], 8, |recorder, maps| {
            recorder.enlarged_by_corners(&maps[0], to)
        });
        agree(&format!("{from:?} to {to:?}"), &found.values, &expected);
    }
    let [x, other] = ["x", "other"].map(|name| HostMap::random((5, 7), 10, name));
    let found = computed(&gpu, packer(), &[&x], 10, |recorder, maps| {
        recorder.rectified(&maps[0])
    });
    agree("rectified", &found.values, &x.clone().rectified().values);
    let found = computed(&gpu, packer(), &[&x, &other], 10, |recorder, maps| {
        recorder.sum(&maps[0], &maps[1])
    });
    agree("sum", &found.values, &x.clone().plus(&other).values);
    let found = computed(&gpu, packer(), &[&x], 4, |recorder, maps| {
        recorder.packed(&maps[0])
    });
    let firsts: Vec<f32> = x.values.chunks_exact(10).map(|pixel| pixel[0]).collect();
    agree("packed", &found.values[..35], &firsts);

    for side in [2, 4] {
        let layer = Convolution::new([side * side * 8, 10, 1], ConvSpec::pointwise(), true);
        let product = layer.on_cpu(&x);
        let pixels = (0..5 * side).flat_map(|i| (0..7 * side).map(move |j| (i, j)));
        let expected = pixels.flat_map(|(i, j)| {
            let place = i % side * side + j % side;
            let pixel = i / side * 7 + j / side;
            product.values[(pixel * side * side + place) * 8..][..8].to_vec()
        });
        let expected: Vec<f32> = expected.collect();
        let packer = packer();
        let prepared = layer.on_gpu(&packer);
        let found = computed(&gpu, packer, &[&x], 8, |recorder, maps| {
            recorder.in_blocks(&prepared, side, &maps[0])
        });
        assert_eq!(found.size, (5 * side, 7 * side));
        agree("blocks", &found.values, &expected);
    }
}

#[test]
fn averages_and_concatenations_agree() {
    let Some(gpu) = gpu() else { return };
    let x = HostMap::random((29, 37), 12, "x");
    for size in [1, 4, 8, 32, 64] {
        let windows = (29_usize.div_ceil(size), 37_usize.div_ceil(size));
        let mut expected = Vec::new();
        for (i, j) in (0..windows.0).flat_map(|i| (0..windows.1).map(move |j| (i, j))) {
            let rows = i * size..((i + 1) * size).min(29);
            let columns = j * size..((j + 1) * size).min(37);
            let count = (rows.len() * columns.len()) as f64;
            for channel in 0..12 {
                let of_row = |y| columns.clone().map(move |x| (y, x));
                let sum: f64 = rows
                    .clone()
                    .flat_map(of_row)
                    .map(|(r, c)| x.at(r, c, channel))
                    .sum();
                expected.push((sum / count) as f32);
            }
        }
        // Among others, in a second launch.
        let sizes: Vec<usize> = (1..=13).chain([size]).collect();
        let found = computed(&gpu, Packer::default(), &[&x], 12, |recorder, maps| {
            recorder.averages(&maps[0], &sizes).pop().unwrap()
        });
        assert_eq!(found.size, windows);
        agree(&format!("windows of {size}"), &found.values, &expected);
    }
    let same = HostMap::random((29, 37), 4, "same");
    let parts: Vec<HostMap> = (1..=13)
        .map(|i| HostMap::random((i, 2 * i), 4 * (1 + i % 3), &i.to_string()))
        .collect();
    let all: Vec<&HostMap> = [&x, &same].into_iter().chain(&parts).collect();
    let channels = all.iter().map(|part| part.channels).sum();
    let enlarged: Vec<HostMap> = all.iter().map(|part| part.enlarged((29, 37))).collect();
    let expected: Vec<f32> = (0..29 * 37)
        .flat_map(|pixel| {
            let of_part =
                |part: &HostMap| part.values[pixel * part.channels..][..part.channels].to_vec();
            enlarged.iter().flat_map(of_part).collect::<Vec<f32>>()
        })
        .collect();
    let found = computed(&gpu, Packer::default(), &all, channels, |recorder, maps| {
        recorder.concatenated([&maps[0], &maps[1]], &maps[2..])
    });
    agree("concatenation", &found.values, &expected);
}

/// An MLP in f64, as its weights describe it.
fn functions(
    head: &HeadWeights,
    (features, logarithm): (&HostMap, &HostMap),
    size: (usize, usize),
    [u, v]: [f64; 2],
) -> Vec<f64> {
    let mut x: Vec<f64> = (0..features.channels)
        .map(|channel| features.between((v, u), size, channel))
        .collect();
    for (place, length) in [(u, size.1), (v, size.0)] {
        x.extend(
            codes([place], length, head.octaves)
                .into_iter()
                .map(f64::from),
        );
    }
    let times = |x: &[f64], layer: &LinearWeights| -> Vec<f64> {
        let rows = x.iter().zip(layer.values.chunks_exact(layer.columns));
        let mut sums = vec![0.0; layer.columns];
        for (value, row) in rows {
            sums.iter_mut()
                .zip(row)
                .for_each(|(s, w)| *s += value * f64::from(*w));
        }
        let bias = layer.bias.iter().map(|b| f64::from(*b));
        sums.iter_mut().zip(bias).for_each(|(s, b)| *s += b);
        sums
    };
    for layer in &head.hidden {
        x = times(&x, layer).into_iter().map(|v| v.max(0.0)).collect();
    }
    let limit = f64::from(MAX_LOG_DEPTH);
    let first = match &head.first {
        FirstFunction::Constant => 1.0,
        FirstFunction::Hidden(weights) => {
            let terms = x.iter().zip(weights).map(|(x, w)| x * f64::from(*w));
            terms.sum::<f64>().clamp(-limit, limit).exp()
        }
        FirstFunction::Extractor => {
            let value = logarithm.between((v, u), size, 0);
            value.clamp(-limit, limit).exp()
        }
    };
    let mut values = vec![first];
    values.extend(times(&x, &head.last));
    values
}

#[test]
fn mlps_agree() {
    let Some(gpu) = gpu() else { return };
    let constant = FirstFunction::Constant;
    let hidden = |width: usize| {
        let weights = random(width, "mean").into_iter().map(|w| 0.1 * w);
        FirstFunction::Hidden(weights.collect())
    };
    for (widths, features, octaves, bases, first) in [
        (vec![8], 5, 0, 3, constant.clone()),
        (vec![128, 128], 64, 5, 128, FirstFunction::Extractor),
        (vec![40, 30, 26], 32, 3, 20, hidden(26)),
        (vec![512, 128, 128], 32, 5, 128, constant),
        (vec![64, 2048], 16, 2, 33, hidden(2048)),
    ] {
        let mut from = features + 4 * octaves;
        let mut linear = |to: usize, name: &str, has_bias: bool| {
            let scale = (2.0 / from as f32).sqrt();
            let values = random(from * to, name).into_iter().map(|w| scale * w);
            let layer = LinearWeights {
                columns: to,
                values: values.collect(),
                bias: random(if has_bias { to } else { 0 }, "bias"),
            };
            from = to;
            layer
        };
        let weights = HeadWeights {
            hidden: widths
                .iter()
                .map(|&to| linear(to, "hidden", true))
                .collect(),
            last: linear(bases, "last", false),
            features,
            octaves,
            first,
        };
        let map = HostMap::random((7, 9), features, "features");
        let logarithm = HostMap::random((7, 9), 1, "logarithm");
        let packer = Packer::default();
        let head = Head::new(weights.clone(), &packer).unwrap();
        let layer = Convolution {
            sizes: [widths[0], features, 1],
            spec: ConvSpec::pointwise(),
            weights: (0..widths[0])
                .flat_map(|o| (0..features).map(move |i| (i, o)))
                .map(|(i, o)| weights.hidden[0].values[i * widths[0] + o])
                .collect(),
            bias: Vec::new(),
        };
        // The first layer on the features, as the plan computes it.
        let input = layer.on_cpu(&map);
        let kept = [input.padded(), logarithm.padded()].concat();
        let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST;
        let buffer = gpu.pool().take(gpu.device(), 4 * kept.len() as u64, usage);
        gpu.upload(Part::Network, &buffer, 0, bytemuck::cast_slice(&kept));
        let features = Features {
            buffer,
            place: Place {
                offset: 0,
                height: 7,
                width: 9,
                quads: quads(widths[0]),
            },
        };
        let packed = storage(&gpu, &packer.into_values());
        let size = (21, 17);
        let places: Vec<[f64; 2]> = (0..37)
            .map(|i| [f64::from(i % 17) - 0.5, f64::from(i) / 2.0])
            .collect();
        let of = |place: [f64; 2]| functions(&weights, (&map, &logarithm), size, place);
        let expected = places.iter().flat_map(|&place| of(place));
        let expected: Vec<f32> = expected.map(|v| v as f32).collect();
        let found = head.at(&gpu, &packed, &features, size, &places);
        agree(&format!("functions of {widths:?}"), &found, &expected);

        let factors: Vec<f64> = random(bases + 1, "factors")
            .into_iter()
            .map(f64::from)
            .collect();
        let pixels = (0..21).flat_map(|y| (0..17).map(move |x| [f64::from(x), f64::from(y)]));
        let sum = |place| {
            let pairs = of(place).into_iter().zip(&factors);
            pairs.map(|(value, factor)| value * factor).sum::<f64>() as f32
        };
        let expected: Vec<f32> = pixels.map(sum).collect();
        let found = head.combine(&gpu, &packed, &features, size, &factors);
        agree(&format!("map of {widths:?}"), &found, &expected);
        gpu.check().unwrap();
    }
}

#[test]
fn a_failure_is_reported_and_yields_no_numbers() {
    let Some(gpu) = gpu() else { return };
    let wrong = gpu.staging(256);
    // A staging buffer cannot be bound: the driver's layer reports it, and nothing panics.
    let buffers = [(&*wrong, 0), (&*wrong, 0), (&*wrong, 0)];
    drop(gpu.bindings().group(gpu.device(), &buffers));
    let error = gpu.check().unwrap_err();
    assert!(error.to_string().contains(gpu.name()), "{error}");
    let staging = gpu.staging(16);
    let submitted = gpu.submit(Part::Map, |_| 0);
    let values = gpu.wait(Part::Map, Pending::new(staging, 4, submitted));
    assert!(values.len() == 4 && values.iter().all(|v| v.is_nan()));
}

#[test]
fn a_kind_of_gpu_that_is_missing_lists_those_there_are() {
    let error = Gpu::open("wgpu:1000".parse().unwrap()).unwrap_err();
    assert!(error.to_string().contains("found: "), "{error}");
    for name in ["cpu", "wgpu:", "wgpu:-1", "wgpu:fast", "cuda"] {
        let adapter = name.parse::<Adapter>();
        assert_eq!(adapter.is_ok(), name == "wgpu:", "{name}");
    }
}
