//! The computational cost of a network.

use super::BasisNet;
use super::decoder::Decoder;
use super::parameters::named;
use burn::module::Module;

impl BasisNet {
    /// Returns the number of multiply-adds with weights for an image of `size` (height, width) whose basis functions are
    /// evaluated at every pixel. Normalisation, pooling and resizing are not counted.
    pub fn multiply_adds(&self, (height, width): (usize, usize)) -> u64 {
        let pixels = |step: usize| (height.div_ceil(step) * width.div_ceil(step)) as u64;
        let extractor = &self.extractor;
        let half = weights(&extractor.stem)
            + weights(&extractor.half)
            + extractor.sharpen.as_ref().map_or(0, weights);
        let quarter = weights(&extractor.quarter)
            + weights(&extractor.wide)
            + weights(&extractor.dilated)
            + weights(&extractor.merge)
            + weights(&extractor.project);
        let pools = extractor.branches.iter().zip(&extractor.pools);
        let branches: u64 = pools
            .map(|(branch, pool)| weights(branch) * pixels(4 * pool))
            .sum();
        let context = extractor.context.iter().zip(1..);
        let context: u64 = context
            .map(|(context, i)| weights(context) * pixels(4 << i))
            .sum();
        let backbone = extractor.backbone.as_ref().map_or(0, |net| {
            let mut step = 2;
            let decoder = extractor.decoder.as_ref();
            let mut levels = decoder.iter().flat_map(|d| d.lateral.iter().zip(&d.mix));
            let blocks = net.blocks.iter().map(|block| {
                let before = pixels(step);
                step *= block.config.stride;
                let after = pixels(step);
                let level = block.config.read.then(|| levels.next()).flatten();
                weights(&block.expand) * before
                    + (weights(&block.depthwise) + weights(&block.project)) * after
                    + level.map_or(0, |(lateral, mix)| weights(lateral) + weights(mix)) * after
            });
            let read = |d: &Decoder| weights(&d.features) + weights(&d.map);
            weights(&net.stem) * pixels(2)
                + blocks.sum::<u64>()
                + decoder.map_or(0, read) * pixels(4)
        });
        let edges = self.edges.as_ref().map_or(0, |net| {
            let down = net.down.iter().enumerate();
            let down: u64 = down
                .map(|(i, layers)| weights(layers) * pixels(1 << i))
                .sum();
            let up = net.up.iter().zip((0..net.up.len()).rev());
            let up = up.map(|(rise, i)| {
                weights(&rise.narrow) * pixels(2 << i) + weights(&rise.mix) * pixels(1 << i)
            });
            down + up.sum::<u64>() + weights(&net.last) * pixels(1)
        });
        half * pixels(2)
            + quarter * pixels(4)
            + branches
            + context
            + backbone
            + weights(&self.head) * pixels(1)
            + edges
    }
}

/// Returns the number of multiplicative weights of a module, without gains and shifts of normalisations.
fn weights<M: Module>(module: &M) -> u64 {
    named(module)
        .iter()
        .filter(|tensor| tensor.data.shape().len() > 1)
        .map(|tensor| tensor.data.num_elements() as u64)
        .sum()
}

#[cfg(test)]
mod tests {
    use crate::model::InitNetwork as _;
    use burn::tensor::Device;
    use lsdc_core::network::NetworkConfig;

    #[test]
    fn a_network_of_the_paper_is_counted_layer_by_layer() {
        let config = NetworkConfig::paper();
        let net = config.init(0, &Device::flex()).unwrap();
        // Counted by hand at 64x64: 32x32 pixels at half the resolution, 16x16 at a quarter; pools of 32, 16, 8 and 4 leave 1,
        // 1, 4 and 16 pixels.
        let half = 9 * (3 * 32 + 2 * 32 * 32) + 6 * 9 * 32 * 32;
        let second = 9 * (32 * 64 + 31 * 64 * 64) + 32 * 64;
        let third = 9 * (64 * 128 + 5 * 128 * 128) + 64 * 128;
        let fourth = 6 * 9 * 128 * 128;
        let merge = 9 * 320 * 128 + 128 * 32;
        let head = 52 * 512 + 512 * 128 + 2 * 128 * 128;
        let by_hand = half * 1024
            + (second + third + fourth + merge) * 256
            + 128 * 32 * (1 + 1 + 4 + 16)
            + head * 4096;
        assert_eq!(net.multiply_adds((64, 64)), by_hand);
    }
}
