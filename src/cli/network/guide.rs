//! The network that predicts guides.

use super::open_completer;
use crate::cli::{install, ui};
use lsdc_core::Completer;
use lsdc_eval::predict::{GuideSpec, MonocularGuide, MonocularSpec};
use lsdc_files::error::Result;
use lsdc_weights::{ResizeLayer, guided_by_head, head_hash, names_no_network, open_weights};
use std::path::Path;

/// Opens weights by name on a device, with scenes that the depth head of their encoder guides unless `--guide` is given.
/// Prints it if that head is not installed.
pub(in crate::cli) fn open_guided_completer(
    weights: Option<&Path>,
    device: &str,
    guide: Option<&GuideSpec>,
) -> Result<Completer> {
    let completer = open_completer(weights, device, guide.is_none())?;
    if guide.is_some() || !completer.can_have_depth_head() {
        return Ok(completer);
    }
    let completer = guided_by_head(completer)?;
    if !completer.has_depth_head() {
        ui::say(install::UNGUIDED);
    }
    Ok(completer)
}

/// The hash of the depth head that guides the completer of [`open_guided_completer`], if one does.
pub(in crate::cli) fn own_guide(
    weights: Option<&Path>,
    device: &str,
    guide: Option<&GuideSpec>,
) -> Result<Option<String>> {
    // burn's tensors are not read back.
    let predicts = device == "cpu" || device.starts_with("wgpu");
    if guide.is_some() || !predicts || names_no_network(weights) {
        return Ok(None);
    }
    head_hash(&open_weights(weights)?.network)
}

/// Name of this guide in reports.
pub(in crate::cli) fn named(hash: &str) -> String {
    format!("depth head of the weights' encoder, {hash}")
}

/// Opens the network that `--guide` names, if it names one, and prints how its guides differ from those that were
/// measured.
pub(in crate::cli) fn open_guide(
    guide: Option<&GuideSpec>,
    device: &str,
) -> Result<Option<MonocularGuide>> {
    let network = MonocularGuide::open(guide)?;
    if let Some(network) = &network {
        for remark in remarks(network.spec(), device) {
            ui::say(&remark);
        }
    }
    Ok(network)
}

fn remarks(spec: MonocularSpec, device: &str) -> Vec<String> {
    let mut remarks = Vec::new();
    if spec.layer == ResizeLayer::Published {
        remarks.push(
            "--head published: accuracy and standard deviations were measured with the learned head"
                .to_owned(),
        );
    }
    if device.starts_with("wgpu") {
        remarks.push(format!(
            "the guide is predicted on the CPU, not on `{device}`"
        ));
    }
    remarks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_head_and_the_cpu_are_remarked() {
        let said = |layer: ResizeLayer, device: &str| {
            let short_side = 336;
            remarks(MonocularSpec { short_side, layer }, device).join("\n")
        };
        assert_eq!(said(ResizeLayer::Learned, "cpu"), "");
        let published = said(ResizeLayer::Published, "cpu");
        assert!(published.contains("standard deviations were measured with the learned head"));
        assert!(said(ResizeLayer::Learned, "wgpu:1").contains("on the CPU, not on `wgpu:1`"));
        assert_eq!(said(ResizeLayer::Published, "wgpu").lines().count(), 2);
    }
}
