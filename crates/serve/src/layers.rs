//! `application/vnd.lsdc.layers`: a JSON header and maps of 32-bit floats, for a page that draws them.
//!
//! The length N of the header as a little-endian u32; the header, padded with blanks so that 4 + N is a multiple of 4;
//! the maps, little-endian and row by row, at offsets from the end of the header.

use crate::complete::Completed;
use crate::report::Report;
use lsdc_core::{DepthMap, Observation};
use serde::Serialize;

/// More points than this are not listed one by one.
const LISTED: usize = 20_000;

#[derive(Serialize)]
struct Header<'a> {
    width: usize,
    height: usize,
    layers: Vec<Layer>,
    points: Vec<Point>,
    /// Whether the points are listed; not if there are very many.
    points_listed: bool,
    report: &'a Report,
}

#[derive(Serialize)]
struct Layer {
    name: &'static str,
    offset: usize,
    /// In bytes.
    length: usize,
}

/// A point that was fitted. What is not known is null.
#[derive(Serialize)]
struct Point {
    /// Its place among those given.
    index: usize,
    u: f64,
    v: f64,
    depth: f32,
    /// Its depth minus that of the map.
    residual: f64,
    /// Its depth minus that which the others predict.
    leave_one_out: Option<f64>,
    /// Of the map at the point.
    standard_deviation: Option<f32>,
    outlier: Judged,
}

/// What the others say of a point.
#[derive(Serialize)]
#[serde(untagged)]
enum Judged {
    NotAsked,
    /// Probably right: `false`.
    Right(bool),
    /// The probability that it is wrong.
    Wrong(f64),
}

/// The bytes of an answer.
pub(crate) fn encode(found: &Completed, report: &Report) -> Vec<u8> {
    let scene = found.completion.scene();
    let maps = [
        ("depth", found.depth.as_ref()),
        ("standard_deviation", found.deviations.as_ref()),
    ];
    let maps = maps
        .into_iter()
        .filter_map(|(name, map)| Some((name, map?)));
    let (mut layers, mut values) = (Vec::new(), Vec::new());
    for (name, map) in maps {
        let offset = values.len();
        values.extend(map.values().iter().copied().flat_map(f32::to_le_bytes));
        layers.push(Layer {
            name,
            offset,
            length: values.len() - offset,
        });
    }
    let listed = found.completion.report().used <= LISTED;
    let header = Header {
        width: scene.width(),
        height: scene.height(),
        layers,
        points: if listed { points(found) } else { Vec::new() },
        points_listed: listed,
        report,
    };
    // Numbers and names always have a form.
    let mut header = serde_json::to_vec(&header).unwrap_or_default();
    header.resize(header.len().next_multiple_of(4), b' ');
    let mut bytes = Vec::with_capacity(4 + header.len() + values.len());
    bytes.extend((header.len() as u32).to_le_bytes());
    bytes.extend(header);
    bytes.extend(values);
    bytes
}

fn points(found: &Completed) -> Vec<Point> {
    let given = found.points.points.as_slice();
    let residuals = found.completion.residuals();
    // Leverages take a while: only where points are judged at all.
    let others = found
        .outliers
        .as_ref()
        .map(|_| found.completion.leave_one_out());
    let mut outlier: Vec<Judged> = given
        .iter()
        .map(|_| match found.outliers {
            Some(_) => Judged::Right(false),
            None => Judged::NotAsked,
        })
        .collect();
    for wrong in found.outliers.iter().flatten() {
        if let Some(judged) = outlier.get_mut(wrong.index) {
            *judged = Judged::Wrong(wrong.probability);
        }
    }
    let rows = given.iter().zip(residuals).zip(outlier).enumerate();
    let used = rows.filter(|(_, ((_, residual), _))| residual.is_finite());
    let point = |(index, ((point, residual), outlier)): (usize, ((&Observation, f64), Judged))| {
        let others = others.as_ref().and_then(|others| others.get(index));
        Point {
            index,
            u: point.u,
            v: point.v,
            depth: point.depth,
            residual,
            leave_one_out: others.copied().filter(|error| error.is_finite()),
            standard_deviation: found.deviations.as_ref().and_then(|map| at(map, point)),
            outlier,
        }
    };
    used.map(point).collect()
}

/// The value of a map at the pixel of a point.
fn at(map: &DepthMap, point: &Observation) -> Option<f32> {
    map.get(point.u.round() as usize, point.v.round() as usize)
}
