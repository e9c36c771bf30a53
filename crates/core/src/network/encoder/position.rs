//! Position embeddings of tokens, interpolated from the trained ones.

/// `DINOv2` adds this to the number of patches before dividing it by that of the table, so that rounding loses none.
const OFFSET: f64 = 0.1;

/// Interpolates `[1 + rows x columns, channels]` from a table `[1 + side x side, channels]` by cubic convolution (Keys 1981).
pub fn positions(
    table: &[f32],
    side: usize,
    channels: usize,
    (rows, columns): (usize, usize),
) -> Vec<f32> {
    let (class, table) = table.split_at(channels);
    let mut found = class.to_vec();
    if (rows, columns) == (side, side) {
        found.extend(table);
        return found;
    }
    let (down, across) = (axis(rows, side), axis(columns, side));
    for (tops, row_weights) in &down {
        for (lefts, column_weights) in &across {
            let from = found.len();
            found.resize(from + channels, 0.0);
            for (top, row_weight) in tops.iter().zip(row_weights) {
                for (left, column_weight) in lefts.iter().zip(column_weights) {
                    let weight = (row_weight * column_weight) as f32;
                    let entry = &table[(top * side + left) * channels..][..channels];
                    let sums = found[from..].iter_mut().zip(entry);
                    sums.for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
    }
    found
}

/// For each of `to` positions, returns four of `from` positions and their weights; positions beyond the border are clamped to
/// it.
fn axis(to: usize, from: usize) -> Vec<([usize; 4], [f64; 4])> {
    let scale = from as f64 / (to as f64 + OFFSET);
    let place = |i: usize| {
        let place = (i as f64 + 0.5) * scale - 0.5;
        let (first, fraction) = (place.floor(), place - place.floor());
        let entry = |k: i64| (first as i64 + k - 1).clamp(0, from as i64 - 1) as usize;
        let weight = |k: i64| cubic((fraction - (k - 1) as f64).abs());
        ([0, 1, 2, 3].map(entry), [0, 1, 2, 3].map(weight))
    };
    (0..to).map(place).collect()
}

/// The kernel of cubic convolution with the slope of `PyTorch` and `OpenCV`.
fn cubic(distance: f64) -> f64 {
    const SLOPE: f64 = -0.75;
    let d = distance;
    if d <= 1.0 {
        ((SLOPE + 2.0) * d - (SLOPE + 3.0)) * d * d + 1.0
    } else if d < 2.0 {
        (((d - 5.0) * d + 8.0) * d - 4.0) * SLOPE
    } else {
        0.0
    }
}
