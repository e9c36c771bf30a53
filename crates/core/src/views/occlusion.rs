//! Carried points behind the surface that the points around them span.

use super::carry::Carried;
use super::report::ViewReport;
use super::support::tolerance;
use super::{PosedView, joined};
use crate::error::Result;
use crate::fit::{Changes, FitMethod};
use crate::scene::Scene;

/// Removes the carried points farther away than all other points predict, by the leave-one-out errors of a fit of the basis
/// functions alone, which costs a tenth of the fit that follows. Occluded points are few among points of all views, so
/// that the others outweigh them. Points in front of their prediction are kept: edges of what is near.
pub(super) fn remove(
    scene: &Scene,
    own: &PosedView,
    carried: &mut Vec<Carried>,
    views: &mut [ViewReport],
) -> Result<()> {
    if carried.is_empty() {
        return Ok(());
    }
    let plain = scene.completer().fit_config().changed(&Changes {
        method: Some(FitMethod::Lse),
        robust: Some(None),
        ..Changes::default()
    });
    let scene = scene.without_mirror().with_fit(plain)?;
    let errors = scene.complete(&joined(own, carried))?.leave_one_out();
    let mut errors = errors.into_iter().skip(own.observations().len());
    carried.retain(|point| {
        let error = errors.next().unwrap_or(0.0);
        let predicted = f64::from(point.observation.depth) - error;
        let is_occluded = predicted > 0.0 && error > tolerance(point) * predicted;
        views[point.view].occluded += usize::from(is_occluded);
        !is_occluded
    });
    Ok(())
}
