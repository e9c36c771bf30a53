//! Launches and transfers of a completion on a GPU.

use lsdc_core::Completer;
use lsdc_eval::data::Frame;
use lsdc_eval::predict::complete;
use lsdc_eval::sampling::Pattern;
use lsdc_files::error::Result;
use lsdc_gpu::{Adapter, Gpu, Traffic};
use serde::Serialize;
use std::fmt::{Display, Formatter};

/// The work of one part of a completion.
#[derive(Debug, Serialize)]
pub(super) struct PartTraffic {
    part: &'static str,
    #[serde(flatten)]
    traffic: Traffic,
}

impl Display for PartTraffic {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Traffic {
            launches,
            uploads,
            readbacks,
            bytes_up,
            bytes_down,
            ..
        } = self.traffic;
        let kilobytes = |bytes: u64| bytes as f64 / 1e3;
        write!(
            f,
            "{:<9} {launches:>5} launches, {uploads} uploads of {:.0} kB, {readbacks} read-backs of {:.0} kB",
            self.part,
            kilobytes(bytes_up),
            kilobytes(bytes_down)
        )
    }
}

/// Counts one more completion; `None` on other devices, and for networks on burn's tensors.
pub(super) fn traffic(
    name: &str,
    completer: &Completer,
    frame: &Frame,
    points: &Pattern,
) -> Result<Vec<PartTraffic>> {
    let opened = name.parse::<Adapter>().and_then(Gpu::shared);
    let Ok(gpu) = opened else {
        return Ok(Vec::new());
    };
    let before = gpu.traffic();
    let sparse = points.draw(frame, 0)?;
    complete(completer, &frame.rgb, &sparse)?.depth()?;
    let parts = gpu.traffic().into_iter().zip(before);
    let parts = parts.map(|((part, after), (_, before))| PartTraffic {
        part: part.name(),
        traffic: after - before,
    });
    Ok(parts
        .filter(|part| part.traffic != Traffic::default())
        .collect())
}
