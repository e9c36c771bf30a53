//! A file of parameters below the options of the command line.

use crate::cli::args::{Args, Command, NodeArgs};
use clap::Parser as _;
use lsdc_files::error::{Error, Result};
use lsdc_node::Parameters;
use std::path::Path;

/// `use_sim_time` and similar parameters do not apply: all times are message stamps.
const WITHOUT_EFFECT: [&str; 1] = ["use_sim_time"];
/// Options that are no parameters.
const NO_PARAMETERS: [&str; 2] = ["params_file", "name"];
/// Truth values of options that are named the other way around.
const OPPOSITE: (&str, &str) = ("deskew", "--no-deskew");

/// The arguments with what the file of parameters says of those that are not given.
pub(super) fn with_file(args: &NodeArgs) -> Result<NodeArgs> {
    let Some(path) = &args.params_file else {
        return Ok(args.clone());
    };
    let given = std::env::args_os().skip(1);
    let given: Vec<String> = given
        .map(|arg| arg.to_string_lossy().into_owned())
        .collect();
    let found = Parameters::read(path, args.name.as_deref().unwrap_or("lsdc"))?;
    merged(&options(path, &found, &given)?, &given)
}

/// The parameters as options, but for those that are given.
fn options(path: &Path, found: &Parameters, given: &[String]) -> Result<Vec<String>> {
    let mut options = Vec::new();
    for name in found.names().filter(|name| !WITHOUT_EFFECT.contains(name)) {
        let values = found.values(name);
        let (option, is_flag) = if name == OPPOSITE.0 {
            (OPPOSITE.1.to_owned(), true)
        } else {
            (format!("--{}", name.replace('_', "-")), is_flag(name))
        };
        if NO_PARAMETERS.contains(&name) {
            let what = format!("`{name}` is an option, but no parameter");
            return Err(Error::format(path, what).hint("give it on the command line"));
        }
        let same = |given: &&String| **given == option || given.starts_with(&format!("{option}="));
        if given.iter().any(|given| same(&given)) {
            continue;
        }
        if !is_flag {
            options.extend(values.iter().map(|value| format!("{option}={value}")));
            continue;
        }
        let is_set = match values {
            [value] if value == "true" => name != OPPOSITE.0,
            [value] if value == "false" => name == OPPOSITE.0,
            _ => {
                let what = format!("`{name}` is neither true nor false");
                return Err(Error::format(path, what));
            }
        };
        options.extend(is_set.then_some(option));
    }
    Ok(options)
}

/// Whether an option has no value.
fn is_flag(name: &str) -> bool {
    [
        "standard_deviation",
        "outliers",
        "cloud",
        "views",
        "reliable",
    ]
    .contains(&name)
}

/// The arguments of the command line with more options.
fn merged(options: &[String], given: &[String]) -> Result<NodeArgs> {
    let program = std::iter::once("lsdc");
    let all = given.iter().map(String::as_str);
    let all = program.chain(all).chain(options.iter().map(String::as_str));
    let parsed = Args::try_parse_from(all).map_err(|error| {
        let text = error.to_string();
        let line = text.lines().next().unwrap_or_default();
        let line = line.trim_start_matches("error: ").to_owned();
        Error::config(line)
            .hint("check the file of parameters: names are those of the options, with underscores")
    })?;
    match parsed.command {
        Command::Node(args) => Ok(*args),
        _ => Err(Error::config("the arguments are not those of `lsdc node`")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(text: &str) -> Vec<String> {
        text.split(' ').map(str::to_owned).collect()
    }

    fn with(yaml: &str, command: &str) -> Result<NodeArgs> {
        let path = Path::new("robot.yaml");
        let yaml = format!("/**:\n  ros__parameters:\n{yaml}");
        let found = Parameters::parse(path, &yaml, "lsdc")?;
        let given = given(command);
        merged(&options(path, &found, &given)?, &given)
    }

    #[test]
    fn options_take_precedence_over_parameters() {
        let yaml = "    image: /a\n    points: /b\n    cloud: true\n    outliers: false\n    deskew: false\n    tf: [/tf, /x/tf_static]\n    \
                    views: true\n    views_count: 4\n    depth_unit: cm\n    max_latency: 0.05\n    use_sim_time: true\n";
        let args = with(yaml, "node --image /c --wait 0.3").unwrap();
        assert_eq!(args.image.as_deref(), Some("/c"));
        assert_eq!(args.points.as_deref(), Some("/b"));
        assert_eq!(args.tf, ["/tf", "/x/tf_static"]);
        assert_eq!((args.max_latency, args.wait), (Some(0.05), Some(0.3)));
        assert!(args.cloud && args.views && !args.outliers && args.no_deskew);
        assert_eq!(args.views_count, Some(4));
        assert_eq!(args.depth_unit.unwrap().metres(), 0.01);
    }

    #[test]
    fn unknown_parameters_are_refused() {
        for (yaml, what) in [
            ("    imgae: /a\n", "--imgae"),
            ("    cloud: 3\n", "neither true nor false"),
            ("    tolerance: soon\n", "soon"),
            ("    name: other\n", "no parameter"),
        ] {
            let error = with(yaml, "node").unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }
}
