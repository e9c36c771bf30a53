//! Even subsampling of many carried points.

use super::carry::Carried;
use super::{PosedView, ViewReport};

/// Mean number of kept points per cell of the grid.
const TO_A_CELL: f64 = 2.0;

/// Keeps at most `most` points, spread as evenly over the image as possible. Points are taken from the cells of a grid with the
/// fewest points so far, including the image's own, and within a cell in the order of their precision.
pub(super) fn thin(
    own: &PosedView,
    most: usize,
    carried: &mut Vec<Carried>,
    views: &mut [ViewReport],
) {
    if carried.len() <= most {
        return;
    }
    let (width, height) = own.size();
    let area = (width * height) as f64;
    let side = (TO_A_CELL * area / most.max(1) as f64).sqrt().max(1.0);
    let across = (width as f64 / side).ceil() as usize;
    let cell = |u: f64, v: f64| {
        let [column, row] = [u, v].map(|place| ((place + 0.5).max(0.0) / side) as usize);
        row * across + column.min(across - 1)
    };
    let cells = across * ((height as f64 / side).ceil() as usize + 1);
    let mut taken = vec![0_usize; cells];
    for point in own.observations() {
        let (u, v) = (point.u, point.v);
        if u >= -0.5 && v >= -0.5 && u < width as f64 && v < height as f64 {
            taken[cell(u, v)] += 1;
        }
    }
    // Precise points first; ties keep their order.
    let mut order: Vec<usize> = (0..carried.len()).collect();
    order.sort_by(|&a, &b| carried[a].deviation.total_cmp(&carried[b].deviation));
    let mut ranked: Vec<(usize, usize, usize)> = Vec::with_capacity(order.len());
    for (place, &index) in order.iter().enumerate() {
        let point = &carried[index].observation;
        let rank = &mut taken[cell(point.u, point.v)];
        ranked.push((*rank, place, index));
        *rank += 1;
    }
    ranked.sort_unstable();
    let mut is_kept = vec![false; carried.len()];
    for &(_, _, index) in ranked.iter().take(most) {
        is_kept[index] = true;
    }
    let mut kept = is_kept.into_iter();
    carried.retain(|point| {
        let is_kept = kept.next().unwrap_or(false);
        views[point.view].thinned += usize::from(!is_kept);
        is_kept
    });
}
