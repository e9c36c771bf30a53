//! Path templates such as `{split}/{scene}/{frame}_depth.png`.

use lsdc_files::error::{Error, Result};
use std::collections::BTreeMap;

/// The text captured by each name of a template.
pub(super) type Captures = BTreeMap<String, String>;

/// A relative path with names in braces; a name matches any text without a slash.
#[derive(Clone, Debug)]
pub(super) struct Template {
    text: String,
    parts: Vec<Part>,
}

#[derive(Clone, Debug)]
enum Part {
    Literal(String),
    Name(String),
}

impl Template {
    /// Parses a template.
    pub(super) fn new(text: &str) -> Result<Self> {
        let broken = || {
            Error::config(format!("`{text}` is not a path template"))
                .hint("write names in braces, as in `{scene}/{frame}.jpg`")
        };
        let mut parts = Vec::new();
        let mut remaining = text;
        while let Some(open) = remaining.find('{') {
            let close = remaining[open..].find('}').ok_or_else(broken)? + open;
            if open > 0 {
                parts.push(Part::Literal(remaining[..open].to_owned()));
            }
            if close == open + 1 || matches!((open, parts.last()), (0, Some(Part::Name(_)))) {
                return Err(broken());
            }
            parts.push(Part::Name(remaining[open + 1..close].to_owned()));
            remaining = &remaining[close + 1..];
        }
        if !remaining.is_empty() {
            parts.push(Part::Literal(remaining.to_owned()));
        }
        Ok(Self {
            text: text.to_owned(),
            parts,
        })
    }

    /// Returns the folder depth of matches below the root, counting the file.
    pub(super) fn depth(&self) -> usize {
        self.text.matches('/').count() + 1
    }

    /// Returns the text captured by each name if `path` (with `/` between folders) matches.
    ///
    /// A name matches the shortest text that lets the rest match; all occurrences of a name must match the same text.
    pub(super) fn captures(&self, path: &str) -> Option<Captures> {
        fn walk(parts: &[Part], path: &str, found: &mut Captures) -> bool {
            match parts.split_first() {
                None => path.is_empty(),
                Some((Part::Literal(text), remaining)) => path
                    .strip_prefix(text.as_str())
                    .is_some_and(|tail| walk(remaining, tail, found)),
                Some((Part::Name(name), remaining)) => {
                    if let Some(value) = found.get(name).cloned() {
                        return path
                            .strip_prefix(value.as_str())
                            .is_some_and(|tail| walk(remaining, tail, found));
                    }
                    let limit = path.find('/').unwrap_or(path.len());
                    let ends = path[..limit].char_indices().map(|(i, c)| i + c.len_utf8());
                    for end in ends {
                        found.insert(name.clone(), path[..end].to_owned());
                        if walk(remaining, &path[end..], found) {
                            return true;
                        }
                    }
                    found.remove(name);
                    false
                }
            }
        }
        let mut found = Captures::new();
        walk(&self.parts, path, &mut found).then_some(found)
    }

    /// Returns the path with every name replaced by its text.
    pub(super) fn fill(&self, captures: &Captures) -> Result<String> {
        self.parts
            .iter()
            .map(|part| match part {
                Part::Literal(text) => Ok(text.as_str()),
                Part::Name(name) => captures.get(name).map(String::as_str).ok_or_else(|| {
                    Error::config(format!(
                        "`{}` uses `{{{name}}}`, which the colour template does not name",
                        self.text
                    ))
                }),
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_found_and_filled() {
        let rgb = Template::new("{split}/{scene}/{frame}.jpg").unwrap();
        let depth = Template::new("{split}/{scene}/{frame}_depth.png").unwrap();
        let found = rgb.captures("val/kitchen_0004/00001.jpg").unwrap();
        assert_eq!(found["scene"], "kitchen_0004");
        assert_eq!(
            depth.fill(&found).unwrap(),
            "val/kitchen_0004/00001_depth.png"
        );
        assert!(rgb.captures("val/a/b/00001.jpg").is_none());
        assert!(rgb.captures("val/a/00001_depth.png").is_none());
        assert_eq!(rgb.depth(), 3);
    }

    #[test]
    fn a_repeated_name_must_agree() {
        let template = Template::new("{a}/{a}_{b}.png").unwrap();
        assert_eq!(template.captures("x/x_1.png").unwrap()["b"], "1");
        assert!(template.captures("x/y_1.png").is_none());
    }

    #[test]
    fn broken_templates_are_refused() {
        assert!(Template::new("{open").is_err());
        assert!(Template::new("{}").is_err());
        assert!(Template::new("{a}{b}").is_err());
    }
}
