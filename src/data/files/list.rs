//! Lists of points as text: one to a line.

use crate::error::{Error, Result};
use std::path::Path;

/// A point of a list, in pixels and stored units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Listed {
    /// Column; the centre of the first pixel is 0.
    pub(crate) u: f64,
    /// Row.
    pub(crate) v: f64,
    pub(crate) depth: f64,
    /// Standard deviation of the depth.
    pub(crate) sigma: Option<f64>,
}

/// What columns of other programs are called.
const NAMES: [&[&str]; 4] = [
    &["u", "x", "col", "column"],
    &["v", "y", "row"],
    &["d", "depth", "z"],
    &["sigma", "std", "deviation"],
];

/// Reads `u, v, depth` and, if there is a fourth column, the standard deviation, separated by
/// commas, semicolons or blanks. A first line that is no number names the columns, in any order;
/// others are left out. `#` begins a remark.
pub(crate) fn read_list(path: &Path) -> Result<Vec<Listed>> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let text = String::from_utf8(bytes)
        .map_err(|e| Error::format(path, "is no text").because(e))
        .map_err(|e| e.hint("lists of points are text: `u,v,depth` or `u,v,depth,sigma` a line"))?;
    let mut columns: Option<[Option<usize>; 4]> = None;
    let mut points = Vec::new();
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let fields: Vec<&str> = fields(line);
        let wrong = |what: String| {
            Error::format(path, format!("line {}: {what}", number + 1))
                .hint("a line is `u,v,depth` or `u,v,depth,sigma`, in pixels and units of depth")
        };
        let [u, v, depth, sigma] = match columns {
            Some(columns) => columns,
            None if fields[0].parse::<f64>().is_err() => {
                let found = named(&fields);
                if found[..3].contains(&None) {
                    return Err(wrong(format!("no columns u, v and depth in `{line}`")));
                }
                columns = Some(found);
                continue;
            }
            None => *columns.insert([Some(0), Some(1), Some(2), (fields.len() > 3).then_some(3)]),
        };
        let value = |column: Option<usize>| -> Result<f64> {
            let text = column.and_then(|c| fields.get(c)).copied();
            let text = text.ok_or_else(|| wrong(format!("{} values are too few", fields.len())))?;
            text.parse()
                .map_err(|_| wrong(format!("`{text}` is no number")))
        };
        points.push(Listed {
            u: value(u)?,
            v: value(v)?,
            depth: value(depth)?,
            sigma: sigma.map(|_| value(sigma)).transpose()?,
        });
    }
    if points.is_empty() {
        return Err(Error::format(path, "holds no point"));
    }
    Ok(points)
}

fn fields(line: &str) -> Vec<&str> {
    if line.contains([',', ';']) {
        line.split([',', ';']).map(str::trim).collect()
    } else {
        line.split_whitespace().collect()
    }
}

fn named(fields: &[&str]) -> [Option<usize>; 4] {
    NAMES.map(|names| {
        fields.iter().position(|field| {
            let field = field.trim_matches('"');
            names.iter().any(|name| name.eq_ignore_ascii_case(field))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Listed>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.csv");
        std::fs::write(&path, text).unwrap();
        read_list(&path)
    }

    #[test]
    fn lists_come_in_many_forms() {
        let point = |sigma| Listed {
            u: 3.5,
            v: 2.0,
            depth: 1.25,
            sigma,
        };
        for text in [
            "3.5,2,1.25",
            "# by hand\n\n3.5; 2; 1.25 # metres\n",
            "3.5 2\t1.25\r\n",
            "\u{feff}u,v,d\n3.5,2,1.25\n",
            "\"y\",\"x\",name,depth\n2,3.5,7,1.25\n",
        ] {
            assert_eq!(read(text).unwrap(), [point(None)], "{text}");
        }
        assert_eq!(read("3.5,2,1.25,0.1").unwrap(), [point(Some(0.1))]);
        assert_eq!(
            read("Z std X Y\n1.25 0.1 3.5 2").unwrap(),
            [point(Some(0.1))]
        );
    }

    #[test]
    fn what_is_wrong_is_said_with_its_line() {
        for (text, what) in [
            ("", "holds no point"),
            ("1,2\n", "line 1: 2 values are too few"),
            ("u,v,colour\n1,2,3\n", "line 1: no columns u, v and depth"),
            ("1,2,3\n4,five,6\n", "line 2: `five` is no number"),
            ("1,2,3,4\n1,2,3\n", "line 2: 3 values are too few"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }
}
