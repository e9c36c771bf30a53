use super::*;
use burn::tensor::{Device, TensorData};

#[test]
fn parts_come_back_and_gaps_are_zero() {
    let device = Device::flex();
    let mut layout = Layout::default();
    let lengths = [3, 64, 65, 65, 65, 1, 10, 2, 130, 4, 5];
    layout.push(1, 3);
    layout.push(1, 64);
    layout.push(3, 65);
    lengths[5..]
        .iter()
        .for_each(|&length| layout.push(1, length));
    let values =
        |i: usize| -> Vec<f32> { (0..lengths[i]).map(|j| (100 * i + j + 1) as f32).collect() };
    let parts: Vec<Tensor<1>> = (0..lengths.len())
        .map(|i| Tensor::from_data(TensorData::new(values(i), [lengths[i]]), &device))
        .collect();
    let packed = layout.pack(&parts);
    let all: Vec<f32> = packed.clone().into_data().iter().collect();
    assert_eq!(all.len(), layout.size());
    assert_eq!(all.len() % ALIGNMENT, 0);
    let mut gaps = all.clone();
    for (i, &(start, length)) in layout.places().iter().enumerate() {
        let part: Vec<f32> = layout.part(&packed, i).into_data().iter().collect();
        assert_eq!(part, values(i));
        assert_eq!(all[start..start + length], part);
        gaps[start..start + length].fill(0.0);
    }
    assert!(gaps.iter().all(|v| *v == 0.0));
    // Stacked parts follow each other; others are aligned.
    let starts: Vec<usize> = layout.places().iter().map(|(start, _)| *start).collect();
    assert_eq!(starts[..6], [0, 64, 128, 193, 258, 384]);
}
