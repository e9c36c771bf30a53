//! The soft edge error (Chen, Chen, Cheng, ICCV 2019).

use super::Rules;
use crate::data::DepthMap;
use crate::window;

/// Returns the mean, over the edge pixels of the truth, of the smallest |prediction - true depth in the window|, in metres;
/// `None` without an edge.
pub(super) fn soft_edge_error(
    prediction: &DepthMap,
    truth: &DepthMap,
    rules: &Rules,
) -> Option<f64> {
    let (width, height) = (truth.width(), truth.height());
    let reach = rules.see_window / 2;
    let (mut sum, mut count) = (0.0, 0_usize);
    for y in 0..height {
        for x in 0..width {
            if !is_edge(truth, x, y, rules.see_jump) {
                continue;
            }
            let here = f64::from(prediction.at(x, y));
            let mut smallest = f64::INFINITY;
            for v in window(y, reach, height) {
                for u in window(x, reach, width) {
                    let depth = truth.at(u, v);
                    if depth > 0.0 {
                        smallest = smallest.min((here - f64::from(depth)).abs());
                    }
                }
            }
            sum += smallest;
            count += 1;
        }
    }
    (count > 0).then(|| sum / count as f64)
}

/// Returns whether a true depth and one of its four neighbours differ by a factor above `jump`.
fn is_edge(truth: &DepthMap, x: usize, y: usize, jump: f64) -> bool {
    let here = f64::from(truth.at(x, y));
    let differs = |u: usize, v: usize| {
        let there = f64::from(truth.at(u, v));
        there > 0.0 && here.max(there) > jump * here.min(there)
    };
    here > 0.0
        && ((x > 0 && differs(x - 1, y))
            || (x + 1 < truth.width() && differs(x + 1, y))
            || (y > 0 && differs(x, y - 1))
            || (y + 1 < truth.height() && differs(x, y + 1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_moved_by_one_pixel_costs_nothing() {
        let step = |at: usize| {
            let values = (0..60)
                .map(|i| if i % 10 < at { 1.0 } else { 3.0 })
                .collect();
            DepthMap::new(10, 6, values).unwrap()
        };
        let truth = step(5);
        let see = |window, map: &DepthMap| {
            let rules = Rules {
                see_window: window,
                ..Rules::default()
            };
            soft_edge_error(map, &truth, &rules).unwrap()
        };
        assert_eq!(see(3, &step(6)), 0.0);
        // Without a window one of the two edge columns is 2 m off.
        assert_eq!(see(1, &step(6)), 1.0);
        // A blurred edge is wrong everywhere.
        let blur = DepthMap::new(10, 6, vec![2.0; 60]).unwrap();
        assert_eq!(see(3, &blur), 1.0);
        let flat = DepthMap::new(10, 6, vec![2.0; 60]).unwrap();
        assert!(soft_edge_error(&blur, &flat, &Rules::default()).is_none());
    }
}
