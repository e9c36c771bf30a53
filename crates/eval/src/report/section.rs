//! The results of an experiment: text, tables and pictures, in files and on a page.

use super::drawing::{Drawing, escaped};
use super::html::{END, begin, failed, markup};
use super::{Failure, Table};
use crate::data::write_atomically;
use lsdc_files::error::{Error, Result};
use serde::Serialize;
use std::fmt::{Display, Formatter, Write as _};
use std::path::Path;

/// The results of an experiment.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Section {
    /// Name in files.
    pub name: &'static str,
    /// Title for readers.
    pub title: &'static str,
    /// Description of the experiment.
    pub about: Vec<String>,
    /// Tables of results.
    pub tables: Vec<Table>,
    /// Conclusions as text.
    pub findings: Vec<String>,
    /// Remarks about published numbers.
    pub notes: Vec<String>,
    /// Pictures of results.
    pub figures: Vec<Figure>,
    /// Frames that could not be measured and are excluded from the results.
    pub failures: Vec<Failure>,
}

/// A picture with a name.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Name in files, after the name of the experiment.
    pub name: String,
    /// Caption of the picture.
    pub caption: String,
    /// The picture.
    #[serde(skip)]
    pub drawing: Drawing,
}

impl Section {
    /// Creates an experiment without results.
    pub fn new(name: &'static str, title: &'static str) -> Self {
        Self {
            name,
            title,
            ..Self::default()
        }
    }

    /// Adds a picture.
    pub fn add_figure(&mut self, name: &str, caption: &str, drawing: Drawing) {
        self.figures.push(Figure {
            name: name.to_owned(),
            caption: caption.to_owned(),
            drawing,
        });
    }

    /// Adds a table, and a sentence that names the cells where `ours` is not the best.
    pub fn add_ranked_table(&mut self, table: Table, ours: &str) {
        self.findings.extend(table.ranking_summary(ours));
        self.tables.push(table);
    }

    /// Adds frames that failed, each once.
    pub fn add_failures(&mut self, failures: Vec<Failure>) {
        for failure in failures {
            if !self.failures.contains(&failure) {
                self.failures.push(failure);
            }
        }
    }

    /// Writes `NAME.txt`, `NAME.json`, `NAME.csv` with a blank line between tables, and each picture
    /// as `NAME-FIGURE.svg` and `.png`.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let path = |ending: &str| folder.join(format!("{}{ending}", self.name));
        let text = |ending: &str, text: String| {
            write_atomically(&path(ending), |out| out.write_all(text.as_bytes()))
        };
        let json = serde_json::to_string_pretty(self)
            .map_err(|e| Error::write(&path(".json"), e.into()))?;
        text(".json", json + "\n")?;
        text(".txt", self.to_string())?;
        let tables: Vec<String> = self.tables.iter().map(Table::csv).collect();
        text(".csv", tables.join("\n"))?;
        for figure in &self.figures {
            text(&format!("-{}.svg", figure.name), figure.drawing.document())?;
            let png = figure.drawing.png()?;
            write_atomically(&path(&format!("-{}.png", figure.name)), |out| {
                out.write_all(&png)
            })?;
        }
        Ok(())
    }

    fn html(&self) -> String {
        let mut html = format!("\n<h2 id='{}'>{}</h2>", self.name, escaped(self.title));
        let paragraph = |html: &mut String, text: &str, class: &str| {
            let _ = write!(html, "<p{class}>{}</p>", markup(text));
        };
        self.about
            .iter()
            .for_each(|text| paragraph(&mut html, text, ""));
        self.tables
            .iter()
            .for_each(|table| html.push_str(&table.html()));
        for text in &self.findings {
            paragraph(&mut html, text, " class='finding'");
        }
        for figure in &self.figures {
            let _ = write!(
                html,
                "<figure class='drawn' style='max-width:{:.0}px'>{}<figcaption>{}</figcaption></figure>",
                figure.drawing.width,
                figure.drawing.inline(),
                escaped(&figure.caption)
            );
        }
        if !self.notes.is_empty() {
            html.push_str("<p class='spread'>On the published numbers:</p>");
        }
        for text in &self.notes {
            paragraph(&mut html, text, " class='spread'");
        }
        html.push_str(&failed(&self.failures));
        html
    }
}

/// Writes one page of all experiments.
///
/// # Errors
/// The file cannot be written.
pub fn write_page(path: &Path, title: &str, sections: &[Section]) -> Result<()> {
    let mut page = begin(title);
    page.push_str("<p>Rows in grey do not compete: others published them, on their machines and frames, or they were given more. Bold: the best of the others.</p><ul>");
    for section in sections {
        let title = escaped(section.title);
        let _ = write!(page, "<li><a href='#{}'>{title}</a></li>", section.name);
    }
    page.push_str("</ul>");
    for section in sections {
        page.push_str(&section.html());
    }
    page.push_str(END);
    write_atomically(path, |out| out.write_all(page.as_bytes()))
}

impl Display for Section {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}", self.title)?;
        writeln!(f, "{}\n", "=".repeat(self.title.chars().count()))?;
        for text in &self.about {
            writeln!(f, "{text}")?;
        }
        for table in &self.tables {
            writeln!(f, "\n{table}")?;
        }
        for text in &self.findings {
            writeln!(f, "{text}")?;
        }
        if !self.notes.is_empty() {
            writeln!(f, "\nOn the published numbers:")?;
        }
        for text in &self.notes {
            writeln!(f, "- {text}")?;
        }
        if !self.failures.is_empty() {
            writeln!(f, "\nFrames that failed:")?;
        }
        for Failure { frame, error } in &self.failures {
            writeln!(f, "- {frame}: {error}")?;
        }
        Ok(())
    }
}
