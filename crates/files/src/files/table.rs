//! Tables of points as text: one point per line.

use crate::error::{Error, Result};
use std::borrow::Cow;
use std::path::Path;

/// Meaning of the first three columns of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ColumnMeaning {
    /// u, v and depth.
    Pixels,
    /// x, y and z of a cloud.
    Space,
    /// u, v and depth of outliers.
    Outliers,
    /// Columns without names.
    Unnamed,
}

/// Rows of three or four numbers.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PointTable {
    pub(crate) columns: ColumnMeaning,
    pub(crate) rows: Vec<TableRow>,
    /// Name of a row in messages: a line of a text, a row of an array.
    pub(crate) row: &'static str,
}

/// A point, in stored units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TableRow {
    /// Number of the line in the text, from 1, or of the row in the array.
    pub(crate) number: usize,
    pub(crate) values: [f64; 3],
    /// Standard deviation of the depth; anything in a cloud without names.
    pub(crate) fourth: Option<f64>,
}

/// Names of columns, here and in other programs.
const U: &[&str] = &["u", "col", "column"];
const V: &[&str] = &["v", "row"];
const DEPTH: &[&str] = &["d", "depth"];
const SIGMA: &[&str] = &["sigma", "std", "deviation"];

/// Column that only lists of outliers have.
const BY_THE_OTHERS: &str = "depth_by_the_others";

const HINT: &str = "a line is `u,v,depth` or `u,v,depth,sigma`, in pixels and units of depth, or `x,y,z` of a \
     cloud under a first line that says so; separators are commas, semicolons, tabs or blanks";

/// Reads three or four columns of numbers. A first line that is not numeric names the columns, in any order; other columns
/// are ignored. A comment starting with `#` also names them if it precedes all numbers and names each column. Numbers may
/// be quoted, and may have decimal commas if another separator is used.
pub(crate) fn read_table(path: &Path) -> Result<PointTable> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let text = String::from_utf8(bytes).map_err(|e| {
        let error = Error::format(path, "is not text").because(e);
        error.hint(HINT)
    })?;
    // The columns of `.xyz` are never named; it only contains clouds.
    let is_xyz = super::has_ending(path, "xyz");
    let mut reader = Reader::default();
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        reader.take(number + 1, line, is_xyz).map_err(|what| {
            Error::format(path, format!("line {}: {what}", number + 1)).hint(HINT)
        })?;
    }
    let Reader { layout, rows, .. } = reader;
    let Some(layout) = layout.filter(|_| !rows.is_empty()) else {
        return Err(Error::format(path, "holds no point"));
    };
    if layout.columns == ColumnMeaning::Unnamed && has_decimal_commas(&layout, &rows) {
        let what = "its numbers have no decimal points, and sigma is larger than the depth: these \
             look like decimal commas between commas";
        return Err(Error::format(path, what)
            .hint("separate the numbers by semicolons, or name the columns in the first line"));
    }
    Ok(PointTable {
        columns: layout.columns,
        rows,
        row: "line",
    })
}

/// Whether the fourth column is rather the decimals of the third: `2,944` between commas.
fn has_decimal_commas(layout: &Layout, rows: &[TableRow]) -> bool {
    let larger = |row: &TableRow| row.fourth.is_some_and(|sigma| sigma > row.values[2]);
    let count = rows.iter().filter(|row| larger(row)).count();
    layout.separator == Separator::Comma && layout.decimal.is_none() && 2 * count > rows.len()
}

/// Separator of the numbers of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Separator {
    Comma,
    Semicolon,
    Tab,
    Blank,
}

/// Layout of the lines of a table.
#[derive(Debug)]
struct Layout {
    separator: Separator,
    columns: ColumnMeaning,
    /// Number of fields per line.
    fields: usize,
    /// Fields of the three numbers and, below, of the fourth.
    indices: [usize; 3],
    fourth: Option<usize>,
    /// Decimal mark, once a number has one.
    decimal: Option<char>,
}

#[derive(Debug, Default)]
struct Reader {
    layout: Option<Layout>,
    /// Last comment before the first line.
    remark: Option<String>,
    rows: Vec<TableRow>,
}

type Parsed<T> = std::result::Result<T, String>;

impl Reader {
    fn take(&mut self, number: usize, line: &str, is_xyz: bool) -> Parsed<()> {
        let (line, remark) = line.split_once('#').unwrap_or((line, ""));
        let line = line.trim();
        if line.is_empty() {
            if self.layout.is_none() && !remark.trim().is_empty() {
                self.remark = Some(remark.trim().to_owned());
            }
            return Ok(());
        }
        let Some(layout) = &mut self.layout else {
            let (layout, is_header) = Layout::new(line, self.remark.as_deref(), is_xyz)?;
            self.layout = Some(layout);
            return if is_header {
                Ok(())
            } else {
                self.take(number, line, is_xyz)
            };
        };
        let fields = split(line, layout.separator);
        if fields.len() != layout.fields {
            return Err(format!(
                "{} columns instead of the {} of the lines before",
                fields.len(),
                layout.fields
            ));
        }
        let mut value =
            |index: usize| parsed(&fields[index], layout.separator, &mut layout.decimal);
        let [a, b, c] = layout.indices;
        self.rows.push(TableRow {
            number,
            values: [value(a)?, value(b)?, value(c)?],
            fourth: layout.fourth.map(value).transpose()?,
        });
        Ok(())
    }
}

impl Layout {
    /// Detects the layout from the first line. Also returns whether that is a header.
    fn new(line: &str, remark: Option<&str>, is_xyz: bool) -> Parsed<(Self, bool)> {
        let separator = separator(line);
        let fields = split(line, separator);
        // A line of only quotes has no fields.
        let is_number = |field| parsed(field, separator, &mut None).is_ok();
        let is_header = !fields.first().is_some_and(|field| is_number(field));
        let names: Option<Vec<Cow<'_, str>>> = if is_header {
            Some(fields.clone())
        } else {
            let names = remark.map(|remark| split(remark, self::separator(remark)));
            names.filter(|names| names.len() == fields.len())
        };
        let found = names.as_deref().map(named);
        let (columns, indices, fourth) = match found {
            Some(Ok(found)) => found,
            Some(Err(what)) if is_header => return Err(format!("{what} in `{line}`")),
            _ if fields.len() < 3 => {
                return Err(format!("{} columns are too few", fields.len()));
            }
            _ if is_xyz => (ColumnMeaning::Space, [0, 1, 2], None),
            _ if fields.len() > 4 => {
                let count = fields.len();
                return Err(format!(
                    "{count} columns, and no first line that names them"
                ));
            }
            _ => (
                ColumnMeaning::Unnamed,
                [0, 1, 2],
                (fields.len() > 3).then_some(3),
            ),
        };
        if is_xyz && columns != ColumnMeaning::Space {
            return Err("names pixels in a file of x, y, z".to_owned());
        }
        let layout = Self {
            separator,
            columns,
            fields: fields.len(),
            indices,
            fourth,
            decimal: None,
        };
        Ok((layout, is_header))
    }
}

/// Returns the meaning of named columns, and the positions of the numbers.
fn named(names: &[Cow<'_, str>]) -> Parsed<(ColumnMeaning, [usize; 3], Option<usize>)> {
    let find = |known: &[&str]| {
        let mut fields = names.iter();
        fields.position(|field| known.iter().any(|name| name.eq_ignore_ascii_case(field)))
    };
    let (x, y, z) = (find(&["x"]), find(&["y"]), find(&["z"]));
    let (u, v, depth) = (find(U), find(V), find(DEPTH));
    let sigma = find(SIGMA);
    match (u.or(x), v.or(y), depth.or(z)) {
        (Some(a), Some(b), Some(c)) if u.is_none() && v.is_none() && depth.is_none() => {
            Ok((ColumnMeaning::Space, [a, b, c], sigma))
        }
        (Some(_), Some(_), Some(_)) if u.is_none() && z.is_some() => {
            Err("columns of both x, y, z and depth; call pixels u and v".to_owned())
        }
        (Some(a), Some(b), Some(c)) if find(&[BY_THE_OTHERS]).is_some() => {
            Ok((ColumnMeaning::Outliers, [a, b, c], None))
        }
        (Some(a), Some(b), Some(c)) => Ok((ColumnMeaning::Pixels, [a, b, c], sigma)),
        _ => Err("no columns u, v, depth or x, y, z".to_owned()),
    }
}

fn separator(line: &str) -> Separator {
    // Names may contain spaces, numbers may not.
    let spaced = |field: &Cow<'_, str>| {
        field.contains(char::is_whitespace) && field.contains(|c: char| c.is_ascii_digit())
    };
    let by = |separator| split(line, separator);
    if line.contains(';') {
        Separator::Semicolon
    } else if by(Separator::Tab).len() >= 3 {
        Separator::Tab
    } else if line.contains(',') && !by(Separator::Comma).iter().any(spaced) {
        Separator::Comma
    } else {
        Separator::Blank
    }
}

/// Returns the fields of a line without their quotes. An empty field after the last separator is ignored.
fn split(line: &str, separator: Separator) -> Vec<Cow<'_, str>> {
    let mut quoted = false;
    let mut separates = |c: char| {
        quoted ^= c == '"';
        !quoted
            && match separator {
                Separator::Comma => c == ',',
                Separator::Semicolon => c == ';',
                Separator::Tab => c == '\t',
                Separator::Blank => c.is_whitespace(),
            }
    };
    let fields = line.split(&mut separates);
    let fields = fields.map(|field| field.trim().trim_matches('"').trim());
    let mut fields: Vec<Cow<'_, str>> = if separator == Separator::Blank {
        let filled = fields.filter(|field| !field.is_empty());
        filled.map(Cow::Borrowed).collect()
    } else {
        fields.map(Cow::Borrowed).collect()
    };
    if fields.len() > 1 && fields.last().is_some_and(|field| field.is_empty()) {
        fields.pop();
    }
    fields
}

/// Parses a number with a decimal point, or with a decimal comma if it cannot be a separator; a table uses one of them.
fn parsed(text: &str, separator: Separator, decimal: &mut Option<char>) -> Parsed<f64> {
    let mark = text.chars().find(|c| matches!(c, '.' | ','));
    if mark == Some(',') && separator == Separator::Comma {
        return Err(format!(
            "`{text}` has a comma between commas; write a decimal point, or separate by semicolons"
        ));
    }
    let value = text.replace(',', ".").parse();
    let value = value.map_err(|_| format!("`{text}` is not a number"))?;
    if let Some(mark) = mark
        && *decimal.get_or_insert(mark) != mark
    {
        return Err(format!(
            "`{text}`: the file has decimal points and decimal commas"
        ));
    }
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_as(name: &str, text: &str) -> Result<PointTable> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        read_table(&path)
    }

    fn read(text: &str) -> Result<PointTable> {
        read_as("points.csv", text)
    }

    /// The only row.
    fn row(text: &str) -> ([f64; 3], Option<f64>) {
        let table = read(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        assert_eq!(table.rows.len(), 1, "{text}");
        (table.rows[0].values, table.rows[0].fourth)
    }

    #[test]
    fn tables_come_in_many_forms() {
        for text in [
            "3.5,2,1.25",
            "# by hand\n\n3.5; 2; 1.25 # metres\n",
            "3.5 2\t1.25\r\n",
            "3.5, 2, 1.25",
            "\u{feff}u,v,d\n3.5,2,1.25\n",
            "\"y\",\"x\",name,depth\n2,3.5,7,1.25\n",
            "# u v depth\n3.5 2 1.25\n",
        ] {
            assert_eq!(row(text), ([3.5, 2.0, 1.25], None), "{text}");
        }
        let with_sigma = ([3.5, 2.0, 1.25], Some(0.1));
        assert_eq!(row("3.5,2,1.25,0.1"), with_sigma);
        assert_eq!(row("depth std U V\n1.25 0.1 3.5 2"), with_sigma);
    }

    #[test]
    fn quoted_numbers_and_a_trailing_comma_are_read() {
        for text in [
            "\"3.5\",\"2\",\"1.25\"\n",
            "3.5,2,1.25,\n",
            "u,v,depth,\n3.5,2,1.25,\n",
            "u,v,depth\n3.5,2,1.25,\n",
            "\"3,5\";\"2\";\"1,25\"\n",
        ] {
            assert_eq!(row(text), ([3.5, 2.0, 1.25], None), "{text}");
        }
    }

    #[test]
    fn decimal_commas_keep_their_fraction() {
        for text in [
            "359;270;2,944\n",
            "359\t270\t2,944\n",
            "359 270 2,944\n",
            "u;v;depth\n359;270;2,944\n",
        ] {
            assert_eq!(row(text), ([359.0, 270.0, 2.944], None), "{text}");
        }
        assert_eq!(row("359,5;270;2,944;0,01").1, Some(0.01));
        for (text, what) in [
            ("359,270,2,944\n", "decimal commas between commas"),
            (
                "u,v,depth\n359,270,2,944\n",
                "line 2: 4 columns instead of the 3",
            ),
            ("359,5,270,5,2,944\n", "line 1: 6 columns"),
            ("359,270,\"2,944\"\n", "a comma between commas"),
            ("359.5;270;2,944\n", "decimal points and decimal commas"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(what), "{text}: {error}");
        }
    }

    #[test]
    fn names_tell_clouds_from_pixels() {
        for (text, columns) in [
            ("x,y,z\n1,2,3\n", ColumnMeaning::Space),
            ("X Y Z intensity\n1 2 3 0.5\n", ColumnMeaning::Space),
            ("# x y z\n1 2 3\n", ColumnMeaning::Space),
            ("x,y,depth\n1,2,3\n", ColumnMeaning::Pixels),
            ("u,v,z\n1,2,3\n", ColumnMeaning::Pixels),
            ("x,y,z,u,v,depth\n7,8,9,1,2,3\n", ColumnMeaning::Pixels),
            ("1,2,3\n", ColumnMeaning::Unnamed),
        ] {
            let table = read(text).unwrap();
            assert_eq!(table.columns, columns, "{text}");
            assert_eq!(table.rows[0].values, [1.0, 2.0, 3.0], "{text}");
        }
        let table = read_as("scan.xyz", "1 2 3 255 0 0\n").unwrap();
        assert_eq!(table.columns, ColumnMeaning::Space);
        assert_eq!(table.rows[0].fourth, None);
        let error = read("x,y,z,depth\n1,2,3,4\n").unwrap_err().to_string();
        assert!(error.contains("both x, y, z and depth"), "{error}");
    }

    #[test]
    fn lines_without_a_field_are_refused() {
        for text in ["\"", "\"\"", "\" \"\n1 2 3\n"] {
            assert!(read(text).is_err(), "{text}");
        }
    }

    #[test]
    fn lines_of_other_lengths_are_refused_with_their_number() {
        for text in ["1,2,3\n4,5,6,0.1\n", "1,2,3,0.1\n4,5,6\n"] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains("line 2: "), "{error}");
        }
    }

    #[test]
    fn what_is_wrong_is_said_with_its_line() {
        for (text, what) in [
            ("", "holds no point"),
            ("1,2\n", "line 1: 2 columns are too few"),
            (
                "u,v,colour\n1,2,3\n",
                "line 1: no columns u, v, depth or x, y, z",
            ),
            ("1,2,3\n4,five,6\n", "line 2: `five` is not a number"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }
}
