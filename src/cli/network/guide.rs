//! The network that predicts guides.

use crate::cli::ui;
use lsdc_eval::predict::{GuideSpec, MonocularGuide, MonocularSpec};
use lsdc_files::error::Result;
use lsdc_weights::ResizeLayer;

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
