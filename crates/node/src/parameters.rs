//! Parameter files of ROS 2: YAML with node names, `ros__parameters`, and values.

use lsdc_files::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Key of the parameters of a node.
const PARAMETERS: &str = "ros__parameters";
/// Matches any node.
const ANY: [&str; 2] = ["/**", "**"];

/// The parameters of a node. Supported YAML: nested names with strings, numbers, booleans, and lists of these.
///
/// ```
/// use lsdc_node::Parameters;
///
/// let text = "/**:
///   ros__parameters:
///     image: /camera/image_raw
///     tf: [/tf, /tf_static]
///     max_latency: 0.05 # seconds
/// ";
/// let found = Parameters::parse("robot.yaml".as_ref(), text, "lsdc").unwrap();
/// assert_eq!(found.values("tf"), ["/tf", "/tf_static"]);
/// assert_eq!(found.values("max_latency"), ["0.05"]);
/// assert!(found.names().eq(["image", "max_latency", "tf"]));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Parameters(BTreeMap<String, Vec<String>>);

/// A line with content.
struct Line<'a> {
    number: usize,
    indent: usize,
    text: &'a str,
}

impl Parameters {
    /// Reads the parameters of a node from a file: those of `/**`, overridden by those under its name.
    ///
    /// # Errors
    /// The file cannot be read, is not such YAML, or has no parameters for the node.
    pub fn read(path: &Path, node: &str) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
        Self::parse(path, &text, node)
    }

    /// Same as [`Self::read`] for the text of a file, called `path` in errors.
    ///
    /// # Errors
    /// As for [`Self::read`].
    pub fn parse(path: &Path, text: &str, node: &str) -> Result<Self> {
        let refused = |line: usize, what: &str| {
            Error::format(path, format!("line {line}: {what}"))
                .hint("parameters are `/**:`, `ros__parameters:` and `name: value`, each below and further right")
        };
        // By the names of nodes that they are below: any before this one.
        let mut found = [BTreeMap::new(), BTreeMap::new()];
        let mut above: Vec<(usize, String)> = Vec::new();
        let mut list: Option<(usize, usize, String)> = None;
        for line in lines(text) {
            let Line {
                number,
                indent,
                text,
            } = line;
            if text.contains('\t') {
                return Err(refused(number, "a tab, which YAML does not allow here"));
            }
            if let Some(item) = text.strip_prefix("- ") {
                let Some((_, whose, name)) = list.as_ref().filter(|(above, ..)| indent >= *above)
                else {
                    return Err(refused(number, "an element of no list"));
                };
                let values: &mut Vec<String> = found[*whose].entry(name.clone()).or_default();
                values.push(value(item).ok_or_else(|| refused(number, "a quote without its end"))?);
                continue;
            }
            list = None;
            let Some((name, rest)) = text
                .split_once(": ")
                .or(text.strip_suffix(':').map(|n| (n, "")))
            else {
                return Err(refused(number, "no `name: value`"));
            };
            let name = value(name).ok_or_else(|| refused(number, "a quote without its end"))?;
            above.retain(|(before, _)| *before < indent);
            let names: Vec<&str> = above.iter().map(|(_, name)| name.as_str()).collect();
            let rest = rest.trim();
            let of_node = names.iter().position(|name| *name == PARAMETERS);
            let whose = of_node.and_then(|at| {
                let owner = names[..at].join("/");
                let owner = owner.trim_start_matches('/');
                if ANY.iter().any(|any| any.trim_start_matches('/') == owner) {
                    Some(0)
                } else {
                    (owner == node.trim_start_matches('/')).then_some(1)
                }
            });
            if let (Some(at), Some(whose)) = (of_node, whose) {
                // Nested names have dots between them in ROS.
                let full = [&names[at + 1..], &[name.as_str()]].concat().join(".");
                if rest.is_empty() {
                    list = Some((indent, whose, full));
                } else {
                    let values = values(rest)
                        .ok_or_else(|| refused(number, "a quote or a bracket without its end"))?;
                    found[whose].insert(full, values);
                }
            } else if !rest.is_empty() && of_node.is_none() {
                return Err(refused(number, "a value outside of `ros__parameters`"));
            }
            above.push((indent, name));
        }
        let [mut all, own] = found;
        all.extend(own);
        if all.is_empty() {
            let what = format!("has no parameters of the node `{node}`");
            return Err(
                Error::format(path, what).hint("put them below `/**:` and `ros__parameters:`")
            );
        }
        Ok(Self(all))
    }

    /// The names, in alphabetical order; nested ones have dots.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    /// The values of a parameter: several of a list, none where it is not there.
    pub fn values(&self, name: &str) -> &[String] {
        self.0.get(name).map_or(&[], Vec::as_slice)
    }
}

/// The lines that hold something, without comments.
fn lines(text: &str) -> impl Iterator<Item = Line<'_>> {
    let lines = text.lines().enumerate().map(|(number, line)| {
        let line = without_comment(line).trim_end();
        let text = line.trim_start_matches(' ');
        Line {
            number: number + 1,
            indent: line.len() - text.len(),
            text,
        }
    });
    lines.filter(|line| !line.text.is_empty() && line.text != "---" && !line.text.starts_with('%'))
}

/// A line up to a comment, which begins after a space outside of quotes.
fn without_comment(line: &str) -> &str {
    let (mut quote, mut before) = (None, ' ');
    for (at, letter) in line.char_indices() {
        match (quote, letter) {
            (None, '"' | '\'') => quote = Some(letter),
            (Some(open), _) if letter == open => quote = None,
            (None, '#') if before == ' ' => return &line[..at],
            _ => {}
        }
        before = letter;
    }
    line
}

/// A value without its quotes; `None` if one is missing.
fn value(text: &str) -> Option<String> {
    let text = text.trim();
    for quote in ['"', '\''] {
        if let Some(rest) = text.strip_prefix(quote) {
            return Some(rest.strip_suffix(quote)?.to_owned());
        }
    }
    Some(text.to_owned())
}

/// One value, or those of a list.
fn values(text: &str) -> Option<Vec<String>> {
    let Some(rest) = text.strip_prefix('[') else {
        return Some(vec![value(text)?]);
    };
    let inner = rest.strip_suffix(']')?.trim();
    if inner.is_empty() {
        return Some(Vec::new());
    }
    inner.split(',').map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<Parameters> {
        Parameters::parse("a.yaml".as_ref(), text, "lsdc")
    }

    #[test]
    fn parameters_of_the_node_replace_those_of_all() {
        let found = parsed(
            "# Of a robot.\n/**:\n  ros__parameters:\n    image: '/cam#1/image_raw'  # The left one.\n    cloud: true\n\
             other:\n  ros__parameters:\n    image: /other\n    anything: {else: 1}\n\
             /lsdc:\n  ros__parameters:\n    cloud: false\n    tf:\n      - /tf\n      - \"/tf_static\"\n    qos:\n      depth: 5\n",
        )
        .unwrap();
        assert_eq!(found.values("image"), ["/cam#1/image_raw"]);
        assert_eq!(found.values("cloud"), ["false"]);
        assert_eq!(found.values("tf"), ["/tf", "/tf_static"]);
        assert_eq!(found.values("qos.depth"), ["5"]);
        assert!(found.values("anything").is_empty());
    }

    #[test]
    fn what_is_no_file_of_parameters_is_refused_by_its_line() {
        for (text, what) in [
            ("image: /a\n", "line 1: a value outside"),
            ("/**:\n  ros__parameters:\n    image\n", "line 3: no `name"),
            (
                "/**:\n  ros__parameters:\n    a: [1, 2\n",
                "line 3: a quote or a bracket",
            ),
            ("/**:\n  ros__parameters:\n    a: 'b\n", "line 3: a quote"),
            ("- a\n", "line 1: an element"),
            ("/**:\n\tros__parameters:\n", "line 2: a tab"),
            (
                "other:\n  ros__parameters:\n    a: 1\n",
                "no parameters of the node",
            ),
            ("", "no parameters of the node"),
        ] {
            let error = parsed(text).unwrap_err();
            assert!(error.to_string().contains(what), "{text}: {error}");
            assert!(error.advice().is_some());
        }
    }
}
