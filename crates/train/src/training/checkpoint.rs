//! Checkpoints: the complete state for resuming a run with identical results.

use super::Learner;
use crate::model::parameters::shapes;
use burn::module::Module;
use burn::store::ModuleRecord;
use burn::tensor::Bytes;
use lsdc_eval::data::{write_atomically, write_folder_atomically};
use lsdc_files::error::{Cause, Error, Result};
use lsdc_weights::{Precision, read_tensors, stored_bytes};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Checkpoints of a run, one folder per step. A folder is written under a temporary name and renamed when complete; the last
/// two are kept.
pub(super) struct Checkpoints {
    folder: PathBuf,
}

const KEPT: usize = 2;
const NETWORK: &str = "network.bpk";
const OPTIMISER: &str = "optimiser.safetensors";
const AVERAGE: &str = "average.bpk";

impl Checkpoints {
    pub(super) fn new(run: &Path) -> Self {
        Self {
            folder: run.join("checkpoints"),
        }
    }

    /// Returns the steps of the existing checkpoints, in ascending order.
    pub(super) fn steps(&self) -> Vec<usize> {
        let Ok(entries) = std::fs::read_dir(&self.folder) else {
            return Vec::new();
        };
        let names = entries.filter_map(|e| e.ok()?.file_name().into_string().ok());
        let mut steps: Vec<usize> = names.filter_map(|name| name.parse().ok()).collect();
        steps.sort_unstable();
        steps
    }

    pub(super) fn save<M: Module, O>(&self, step: usize, learner: &Learner<M, O>) -> Result<()> {
        let broken = |e: &dyn std::fmt::Display| {
            Error::new(Cause::Write, format!("cannot encode a checkpoint: {e}"))
        };
        let bytes = |net: &M| {
            let record = net.clone().into_record().into_bytes();
            record.map_err(|e| broken(&e))
        };
        let network = bytes(&learner.net)?;
        let average = learner
            .average
            .as_ref()
            .map(|(net, _)| bytes(net))
            .transpose()?;
        let state = learner.optimiser.tables();
        let tensors = state.iter();
        let tensors = tensors.map(|(name, table)| (name.clone(), table, Precision::Single));
        let state = stored_bytes(tensors, HashMap::new())?;
        let mut files: Vec<(&str, &[u8])> = vec![(NETWORK, &network), (OPTIMISER, &state)];
        files.extend(average.as_deref().map(|bytes| (AVERAGE, bytes)));
        write_folder_atomically(&self.path(step), |folder| {
            for (name, bytes) in files {
                write_atomically(&folder.join(name), |out| out.write_all(bytes))?;
            }
            Ok(())
        })?;
        let steps = self.steps();
        for &old in steps.iter().rev().skip(KEPT) {
            // An extra checkpoint does no harm.
            let _ = std::fs::remove_dir_all(self.path(old));
        }
        Ok(())
    }

    /// Loads the learner as it was after `step`.
    pub(super) fn load<M: Module, O>(
        &self,
        step: usize,
        mut learner: Learner<M, O>,
    ) -> Result<Learner<M, O>> {
        let read = |name: &str| {
            let path = self.path(step).join(name);
            std::fs::read(&path)
                .map(Bytes::from_bytes_vec)
                .map_err(|e| Error::read(&path, e))
        };
        let foreign = |e: &dyn std::fmt::Display| {
            Error::weights(format!(
                "checkpoint `{}` does not belong to this configuration: {e}",
                self.path(step).display()
            ))
            .hint("resume with the `config.toml` of the run folder")
        };
        let filled = |net: M, name: &str| {
            let record = ModuleRecord::from_bytes(read(name)?).map_err(|e| foreign(&e))?;
            net.try_load_record(record).map_err(|e| foreign(&e))
        };
        learner.net = filled(learner.net, NETWORK)?;
        if let Some((net, decay)) = learner.average {
            learner.average = Some((filled(net, AVERAGE)?, decay));
        }
        let path = self.path(step).join(OPTIMISER);
        // The file of earlier versions.
        if path.with_extension("bpk").exists() && !path.exists() {
            return Err(Error::weights(format!(
                "checkpoint `{}` is of an earlier version, with another optimiser",
                self.path(step).display()
            ))
            .hint("finish the run with the version that began it, or begin a new one with `train.start`"));
        }
        let shapes = shapes(&learner.net);
        let restored = learner.optimiser.restore(read_tensors(&path)?, &shapes);
        restored.map_err(|name| foreign(&format_args!("state `{name}`")))?;
        Ok(learner)
    }

    fn path(&self, step: usize) -> PathBuf {
        self.folder.join(format!("{step:08}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::InitNetwork as _;
    use crate::training::TrainConfig;
    use burn::tensor::Device;
    use lsdc_core::fit::FitConfig;
    use lsdc_core::network::NetworkConfig;

    #[test]
    fn a_checkpoint_of_an_earlier_version_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let learner = || {
            let net = NetworkConfig::small().init(0, &Device::flex().autodiff());
            Learner::new(net.unwrap(), &FitConfig::default(), &TrainConfig::default())
        };
        let checkpoints = Checkpoints::new(folder.path());
        checkpoints.save(3, &learner()).unwrap();
        assert_eq!(checkpoints.steps(), [3]);
        assert!(checkpoints.load(3, learner()).is_ok());
        let state = checkpoints.path(3).join(OPTIMISER);
        std::fs::rename(&state, state.with_extension("bpk")).unwrap();
        let Err(error) = checkpoints.load(3, learner()) else {
            panic!("the state of another optimiser was read");
        };
        assert!(error.to_string().contains("earlier version"), "{error}");
        assert!(error.advice().unwrap().contains("train.start"));
        std::fs::remove_file(state.with_extension("bpk")).unwrap();
        let Err(error) = checkpoints.load(3, learner()) else {
            panic!("a missing state was read");
        };
        assert!(error.to_string().contains("cannot read"), "{error}");
    }
}
