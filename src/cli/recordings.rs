//! `lsdc inspect` of recordings.

use super::ui;
use lsdc_files::error::Result;
use lsdc_recordings::{Recording, Survey, TopicSummary};
use serde_json::{Value, json};
use std::path::Path;

/// Prints the contents of a recording, as lines or as one JSON object.
pub(super) fn inspect(path: &Path, as_json: bool) -> Result<()> {
    let mut recording = Recording::open(path)?;
    let survey = Survey::of(&mut recording)?;
    if as_json {
        ui::print(&described(&recording, &survey).to_string());
    } else {
        for line in lines(&recording, &survey) {
            ui::print(&line);
        }
    }
    Ok(())
}

fn lines(recording: &Recording, survey: &Survey) -> Vec<String> {
    let mut lines = vec![
        format!("file      {}", recording.path().display()),
        format!(
            "recording {} topics, {} messages, {}",
            survey.topics.len(),
            survey
                .topics
                .iter()
                .map(|counted| counted.count)
                .sum::<u64>(),
            size(recording.size())
        ),
    ];
    if let Some((first, last)) = survey.times() {
        let (start, length) = (first as f64 * 1e-9, (last - first) as f64 * 1e-9);
        lines.push(format!(
            "duration  {length:.3} s, from {start:.3} s since 1970"
        ));
    }
    lines.extend(
        survey
            .defects
            .lines()
            .map(|what| format!("warning   {what}")),
    );
    let widest =
        |length: fn(&TopicSummary) -> usize| survey.topics.iter().map(length).max().unwrap_or(0);
    let name = widest(|counted| counted.topic.name.len());
    let kind = widest(|counted| counted.topic.kind.len());
    lines.extend(survey.topics.iter().map(|counted| {
        let rate = counted
            .rate()
            .map_or("-".to_owned(), |rate| format!("{rate:.2} Hz"));
        format!(
            "topic     {:<name$}  {:<kind$}  {:>7}  {rate:>10}  {:>9}",
            counted.topic.name,
            counted.topic.kind,
            counted.count,
            size(counted.bytes)
        )
    }));
    lines
}

fn described(recording: &Recording, survey: &Survey) -> Value {
    let topic = |counted: &TopicSummary| {
        json!({
            "name": counted.topic.name, "type": counted.topic.kind, "encoding": counted.topic.encoding,
            "messages": counted.count, "rate": counted.rate(), "bytes": counted.bytes,
        })
    };
    let times = survey.times();
    json!({
        "file": recording.path().display().to_string(), "is": "recording", "bytes": recording.size(),
        "start_ns": times.map(|(first, _)| first),
        "seconds": times.map(|(first, last)| (last - first) as f64 * 1e-9),
        "cut_off": survey.defects.truncated, "damaged": survey.defects.damaged, "first_damage": survey.defects.first_damage,
        "absent": survey.defects.missing_files,
        "topics": survey.topics.iter().map(topic).collect::<Vec<_>>(),
    })
}

/// A number of bytes.
fn size(bytes: u64) -> String {
    let units = ["B", "kB", "MB", "GB", "TB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 999.5 && unit + 1 < units.len() {
        value /= 1000.0;
        unit += 1;
    }
    if unit == 0 {
        format!("{bytes} B")
    } else {
        format!("{value:.1} {}", units[unit])
    }
}
