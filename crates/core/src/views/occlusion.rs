//! Removal of carried points behind the surface spanned by the points around them.

use super::carry::Carried;
use super::report::ViewReport;
use super::support::tolerance;
use super::{PosedView, joined};
use crate::error::Result;
use crate::fit::{Changes, FitMethod};
use crate::scene::Scene;

/// Removes the carried points that are farther away than predicted by all other points, according to the leave-one-out errors
/// of a fit of the basis functions alone. This takes a tenth of the time of the fit that follows. Occluded points are a
/// minority among the points of all views, so that the others outweigh them. Points in front of their prediction are kept,
/// because they may be edges of nearer surfaces.
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
