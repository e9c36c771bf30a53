//! All settings of a run: built-in defaults, then a file, then `--set`, then flags.

use lsdc_core::fit::FitConfig;
use lsdc_core::network::NetworkConfig;
use lsdc_eval::data::DataConfig;
use lsdc_eval::evaluation::EvalConfig;
use lsdc_eval::fit_settings::{FitSettings, merge};
use lsdc_files::error::{Error, Result};
#[cfg(feature = "train")]
use lsdc_paper::systems::SystemConfig;
#[cfg(feature = "train")]
use lsdc_train::training::TrainConfig;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The training section of configuration files, in a build that cannot train.
#[cfg(not(feature = "train"))]
mod unused {
    use super::{Deserialize, Serialize};

    /// Settings that are read and ignored.
    #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
    #[serde(transparent)]
    pub struct Unused(toml::Table);
}
#[cfg(not(feature = "train"))]
use unused::{Unused as SystemConfig, Unused as TrainConfig};

/// The named networks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// The paper's: 3.47 M parameters.
    #[default]
    Paper,
    /// Fewer blocks and a narrower MLP: 2.5 M parameters, about half of the compute.
    Medium,
    /// A slimmer extractor with sharpened features, and a network that judges edges: 1.3 M.
    Sharp,
    /// `sharp` with half the widths and half as many basis functions: 0.3 M parameters.
    Small,
    /// `sharp` that sees more of the image, with a first function that is a map of depth: 3.3 M.
    Taught,
    /// `taught` with a block less, beside five stages of a pretrained `EfficientNet`-Lite0: 3.4 M.
    Lite,
    /// `small` beside the same stages: 1.1 M.
    LiteSmall,
    /// `sharp` on top of a pretrained encoder: 2.1 M beside its 22 M.
    Anything,
}

/// A configuration file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The network by name.
    pub preset: Preset,
    /// The network in full; replaces `preset`.
    pub network: Option<NetworkConfig>,
    /// A system that the paper compares itself with, which is trained in the place of the network.
    pub system: Option<SystemConfig>,
    /// The least-squares fit: what differs from that of the weights, or from the paper's in training.
    pub fit: FitSettings,
    /// The dataset.
    pub data: DataConfig,
    /// Training.
    #[cfg_attr(not(feature = "train"), serde(skip_serializing))]
    pub train: TrainConfig,
    /// Evaluation.
    pub eval: EvalConfig,
}

/// Configurations that come with the program, by file name.
const BUILT_IN: [(&str, &str); 15] = [
    ("nyu.toml", include_str!("../configs/nyu.toml")),
    ("nyu-half.toml", include_str!("../configs/nyu-half.toml")),
    ("nyu-bases.toml", include_str!("../configs/nyu-bases.toml")),
    (
        "nyu-affinities.toml",
        include_str!("../configs/nyu-affinities.toml"),
    ),
    ("nyu-joint.toml", include_str!("../configs/nyu-joint.toml")),
    (
        "nyu-anything.toml",
        include_str!("../configs/nyu-anything.toml"),
    ),
    (
        "nyu-distill.toml",
        include_str!("../configs/nyu-distill.toml"),
    ),
    ("nyu-map.toml", include_str!("../configs/nyu-map.toml")),
    ("nyu-lite.toml", include_str!("../configs/nyu-lite.toml")),
    ("own.toml", include_str!("../configs/own.toml")),
    ("s2d.toml", include_str!("../configs/s2d.toml")),
    ("cspn.toml", include_str!("../configs/cspn.toml")),
    ("lsk.toml", include_str!("../configs/lsk.toml")),
    ("lsk-ours.toml", include_str!("../configs/lsk-ours.toml")),
    ("smoke.toml", include_str!("../configs/smoke.toml")),
];

impl Config {
    /// Reads a file, if any, and applies `key.key=value` settings in order.
    ///
    /// A bare name that is no file in the current folder is looked up among the configurations
    /// that come with the program.
    ///
    /// # Errors
    /// An unreadable file, an unknown key (named, with its line), or a value out of range.
    pub fn load(path: Option<&Path>, settings: &[String]) -> Result<Self> {
        let mut table = match path {
            None => toml::Table::new(),
            Some(path) => parse(&read(path)?, path)?,
        };
        for setting in settings {
            merge(&mut table, assignment(setting)?);
        }
        let config: Self = table.try_into().map_err(|e: toml::de::Error| {
            Error::config(format!("--set: {}", e.message()))
                .hint("`lsdc config` prints every setting and its value")
        })?;
        config.check()?;
        Ok(config)
    }

    /// Whether there are settings of `train` or `system`, which this build ignores.
    #[cfg(not(feature = "train"))]
    pub fn has_ignored_settings(&self) -> bool {
        self.train != TrainConfig::default() || self.system.is_some()
    }

    /// The network that is meant.
    pub fn network(&self) -> NetworkConfig {
        self.network.clone().unwrap_or(match self.preset {
            Preset::Paper => NetworkConfig::paper(),
            Preset::Medium => NetworkConfig::medium(),
            Preset::Sharp => NetworkConfig::sharp(),
            Preset::Small => NetworkConfig::small(),
            Preset::Taught => NetworkConfig::taught(),
            Preset::Lite => NetworkConfig::lite(),
            Preset::LiteSmall => NetworkConfig::lite_small(),
            Preset::Anything => NetworkConfig::anything(),
        })
    }

    /// The settings as a configuration file.
    ///
    /// # Errors
    /// None for a checked configuration.
    pub fn to_toml(&self) -> Result<String> {
        as_toml(self)
    }

    /// The settings as a configuration file, and in comments the whole `[fit]`: what the file leaves
    /// open is that of the weights, or in training as said there.
    ///
    /// # Errors
    /// None for a checked configuration.
    pub fn explained(&self) -> Result<String> {
        let fit = FitSettings::all(&self.fit.over(&FitConfig::default())?)?;
        let whole = as_toml(&toml::Table::from_iter([("fit".to_owned(), fit.0.into())]))?;
        let comments: Vec<String> = whole.lines().map(|line| format!("# {line}")).collect();
        Ok(format!(
            "{}\n# A fit in full. What [fit] leaves open is that of the weights, or in training:\n#\n{}\n",
            self.to_toml()?,
            comments.join("\n")
        ))
    }

    fn check(&self) -> Result<()> {
        self.network().check()?;
        #[cfg(feature = "train")]
        {
            self.system.as_ref().map_or(Ok(()), SystemConfig::check)?;
            self.train.check()?;
        }
        self.fit.over(&FitConfig::default())?;
        self.data.check()?;
        self.eval.check()
    }
}

fn as_toml(settings: &impl Serialize) -> Result<String> {
    toml::to_string_pretty(settings)
        .map_err(|e| Error::config("the settings cannot be written as TOML").because(e))
}

fn read(path: &Path) -> Result<String> {
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(text),
        Err(error) => {
            let built_in = BUILT_IN.iter().find(|(name, _)| Path::new(name) == path);
            let names = BUILT_IN.map(|(name, _)| name).join(", ");
            built_in.map(|(_, text)| (*text).to_owned()).ok_or_else(|| {
                Error::read(path, error).hint(format!("built-in configurations: {names}"))
            })
        }
    }
}

/// The file as a table, once it has been found sound as a whole.
fn parse(text: &str, path: &Path) -> Result<toml::Table> {
    let located = |e: toml::de::Error| {
        let line = e
            .span()
            .map_or(0, |s| text[..s.start].matches('\n').count() + 1);
        Error::config(format!(
            "`{}`, line {line}: {}",
            path.display(),
            e.message()
        ))
        .hint("`lsdc config` prints every setting and its value")
    };
    toml::from_str::<Config>(text).map_err(located)?;
    toml::from_str::<Fit>(text).map_err(located)?;
    toml::from_str(text).map_err(located)
}

/// The fit of a file, whose settings are not known to [`FitSettings`].
#[derive(Deserialize)]
struct Fit {
    #[serde(default, rename = "fit")]
    _fit: FitConfig,
}

/// `a.b=1` as a table; a value that is not TOML counts as text.
fn assignment(setting: &str) -> Result<toml::Table> {
    let (key, value) = setting.split_once('=').ok_or_else(|| {
        Error::config(format!("`--set {setting}` has no `=`")).hint("as in --set train.steps=100")
    })?;
    let quoted = toml::Value::String(value.to_owned());
    toml::from_str(setting)
        .or_else(|_| toml::from_str(&format!("{key} = {quoted}")))
        .map_err(|_| {
            Error::config(format!("`{key}` in `--set {setting}` is not a key"))
                .hint("as in --set train.steps=100")
        })
}

#[cfg(all(test, feature = "train"))]
mod tests {
    use super::*;
    use lsdc_core::fit::{FitMethod, Lambda};

    #[test]
    fn settings_lie_over_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.toml");
        std::fs::write(&path, "preset = \"small\"\n[train]\nsteps = 5\nbatch = 3\n").unwrap();
        let sets = ["train.steps=7".to_owned(), "data.root=/tmp/x".to_owned()];
        let config = Config::load(Some(&path), &sets).unwrap();
        assert_eq!((config.train.steps, config.train.batch), (7, 3));
        assert_eq!(config.data.root.as_deref(), Some(Path::new("/tmp/x")));
        assert_eq!(config.network(), NetworkConfig::small());
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.toml");
        std::fs::write(&path, "[train]\nsteps = 5\nspeed = 3\n").unwrap();
        let error = Config::load(Some(&path), &[]).unwrap_err().to_string();
        assert!(
            error.contains("line 3") && error.contains("speed"),
            "{error}"
        );
        let error = Config::load(None, &["train.speed=1".into()]).unwrap_err();
        assert!(error.to_string().contains("speed"), "{error}");
    }

    #[test]
    fn settings_of_the_fit_lie_over_those_of_the_weights() {
        let weights = FitConfig {
            method: FitMethod::Joint,
            lambda: Lambda::Fixed(0.5),
            ..FitConfig::default()
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.toml");
        std::fs::write(&path, "[fit.joint]\ncosines = 2.0\n").unwrap();
        let set = ["fit.joint.level=1e-5".to_owned(), "fit.lambda=gcv".into()];
        let config = Config::load(Some(&path), &set).unwrap();
        let fit = config.fit.over(&weights).unwrap();
        assert_eq!(fit.method, FitMethod::Joint);
        assert_eq!(
            (fit.joint.cosines, fit.joint.diagonal_regularisation),
            (2.0, 1e-5)
        );
        assert_eq!(
            fit.joint.observation_precision,
            weights.joint.observation_precision
        );
        assert_eq!(fit.lambda, Lambda::Gcv);
        assert_eq!(FitSettings::default().over(&weights).unwrap(), weights);
        assert_eq!(FitSettings::all(&fit).unwrap().over(&weights).unwrap(), fit);

        std::fs::write(&path, "[fit]\nrcond = 1e-5\nrigde = 1.0\n").unwrap();
        let error = Config::load(Some(&path), &[]).unwrap_err().to_string();
        assert!(
            error.contains("line 3") && error.contains("rigde"),
            "{error}"
        );
        let error = Config::load(None, &["fit.joint.level=0".into()]).unwrap_err();
        assert!(error.to_string().contains("level"), "{error}");
    }

    #[test]
    fn an_explained_configuration_is_the_same_and_lists_the_whole_fit() {
        let config = Config::load(Some(Path::new("nyu-joint.toml")), &[]).unwrap();
        let text = config.explained().unwrap();
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), config);
        let (_, comments) = text.split_once("#\n").unwrap();
        let fit: Config = toml::from_str(&comments.replace("# ", "")).unwrap();
        let meant = config.fit.over(&FitConfig::default()).unwrap();
        assert_eq!(fit.fit, FitSettings::all(&meant).unwrap());
    }

    #[test]
    fn shares_must_leave_something_to_the_first_dataset() {
        let load = |sets: &[&str]| {
            let sets: Vec<String> = sets.iter().map(|s| (*s).to_owned()).collect();
            Config::load(None, &sets)
        };
        let more = |shares: &str| format!("data.more=[{shares}]");
        let config = load(&[&more("{ share = 0.4 }, { dataset = \"nyu\" }")]).unwrap();
        assert_eq!(config.data.more.len(), 2);
        for wrong in [
            "{ share = 0.6 }, { share = 0.4 }",
            "{ share = 0.0 }",
            "{ more = [{ dataset = \"nyu\" }] }",
        ] {
            assert!(load(&[&more(wrong)]).is_err(), "{wrong}");
        }
        assert!(load(&["data.share=0.5"]).is_err());
        let alone = load(&["train.loss.teacher_span=0.1"]).unwrap_err();
        assert!(alone.to_string().contains("train.teacher"), "{alone}");
        let measured = "train.teacher.target=\"measured\"";
        let nothing = load(&[measured]).unwrap_err();
        assert!(nothing.to_string().contains("teacher_span"), "{nothing}");
        load(&[measured, "train.loss.teacher_span=0.1"]).unwrap();
    }

    #[test]
    fn built_in_configurations_are_sound() {
        for (name, _) in BUILT_IN {
            let config = Config::load(Some(Path::new(name)), &[]).unwrap();
            config.train.check().unwrap();
            let text = config.to_toml().unwrap();
            assert_eq!(toml::from_str::<Config>(&text).unwrap(), config);
        }
    }
}
