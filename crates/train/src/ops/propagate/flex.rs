//! The operation on flex, image by image, each with all threads.

use super::{NEIGHBOURS, Plain, PropagateBackend, PropagateGradients};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata as _};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;
use lsdc_kernels::propagate::{propagate, propagate_gradients};

impl PropagateBackend for Flex {
    fn spread(
        weights: FloatTensor<Self>,
        start: FloatTensor<Self>,
        known: FloatTensor<Self>,
        steps: usize,
    ) -> FloatTensor<Self> {
        if start.dtype() != DType::F32 {
            return Plain::<Self>::new(weights, start, known).run(steps).1;
        }
        let [n, height, width] = sizes(&start);
        let all = [weights, start, known].map(|tensor| tensor.to_contiguous());
        let [weights, start, known] = all.each_ref().map(FlexTensor::storage::<f32>);
        let pixels = height * width;
        let mut output = Vec::with_capacity(n * pixels);
        for image in 0..n {
            let of = image * pixels..(image + 1) * pixels;
            output.extend(propagate(
                &weights[NEIGHBOURS * of.start..NEIGHBOURS * of.end],
                &start[of.clone()],
                &known[of],
                (height, width),
                steps,
            ));
        }
        FlexTensor::from_data(TensorData::new(output, [n, height, width]))
    }
}

impl PropagateGradients for Flex {
    fn spread_backward(
        weights: FloatTensor<Self>,
        start: FloatTensor<Self>,
        known: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        steps: usize,
    ) -> [FloatTensor<Self>; 2] {
        if start.dtype() != DType::F32 {
            return Plain::<Self>::new(weights, start, known).backward(grad, steps);
        }
        let [n, height, width] = sizes(&start);
        let all = [weights, start, known, grad].map(|tensor| tensor.to_contiguous());
        let [weights, start, known, grad] = all.each_ref().map(FlexTensor::storage::<f32>);
        let pixels = height * width;
        let mut of_weights = Vec::with_capacity(n * pixels * NEIGHBOURS);
        let mut of_start = Vec::with_capacity(n * pixels);
        for image in 0..n {
            let of = image * pixels..(image + 1) * pixels;
            let found = propagate_gradients(
                &weights[NEIGHBOURS * of.start..NEIGHBOURS * of.end],
                &start[of.clone()],
                &known[of.clone()],
                &grad[of],
                (height, width),
                steps,
            );
            of_weights.extend(found.0);
            of_start.extend(found.1);
        }
        let weights = TensorData::new(of_weights, [n, height, width, NEIGHBOURS]);
        let start = TensorData::new(of_start, [n, height, width]);
        [weights, start].map(FlexTensor::from_data)
    }
}

fn sizes(map: &FlexTensor) -> [usize; 3] {
    let shape = map.shape();
    [shape[0], shape[1], shape[2]]
}
