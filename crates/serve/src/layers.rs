//! `application/vnd.lsdc.layers`: a JSON header and maps of 32-bit floats, for a page that draws them.
//!
//! The length N of the header as a little-endian u32; the header, padded with blanks so that 4 + N is a multiple of 4;
//! the maps, little-endian and row by row, at offsets from the end of the header.

use crate::complete::CompletionResult;
use crate::report::JsonReport;
use lsdc_core::{DepthMap, Observation};
use serde::Serialize;
use std::collections::HashMap;

/// More points than this are not listed one by one.
const LISTED: usize = 20_000;

#[derive(Serialize)]
struct Header<'a> {
    width: usize,
    height: usize,
    layers: Vec<LayerEntry>,
    points: Vec<Point>,
    /// Whether the points are listed; not if there are very many.
    points_listed: bool,
    report: &'a JsonReport,
}

#[derive(Serialize)]
struct LayerEntry {
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
    /// Value of the map at the point.
    standard_deviation: Option<f32>,
    outlier: OutlierTest,
}

/// The result of the outlier test for a point.
#[derive(Serialize)]
#[serde(untagged)]
enum OutlierTest {
    NotRun,
    /// Always `false`.
    Inlier(bool),
    /// The probability that it is an outlier.
    Outlier(f64),
}

/// The bytes of an answer.
pub(crate) fn encode(found: &CompletionResult, report: &JsonReport) -> Vec<u8> {
    let scene = found.completion.scene();
    let depth = found.depth.iter().map(|map| ("depth", map));
    let deviations = found.deviations.iter();
    let deviations = deviations.map(|map| ("standard_deviation", map));
    let (mut layers, mut values) = (Vec::new(), Vec::new());
    for (name, map) in depth.chain(deviations) {
        let offset = values.len();
        values.extend(map.values().iter().copied().flat_map(f32::to_le_bytes));
        layers.push(LayerEntry {
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

fn points(found: &CompletionResult) -> Vec<Point> {
    // Leverages take a while: only with the outlier test.
    let tested = found.outliers.as_ref().map(|outliers| {
        let outliers = outliers.iter();
        let outliers = outliers.map(|outlier| (outlier.index, outlier.probability));
        let outliers: HashMap<usize, f64> = outliers.collect();
        (found.completion.leave_one_out(), outliers)
    });
    let given = found.points.points.iter();
    let rows = given.zip(found.completion.residuals()).enumerate();
    let used = rows.filter(|(_, (_, residual))| residual.is_finite());
    let point = |(index, (point, residual)): (usize, (&Observation, f64))| Point {
        index,
        u: point.u,
        v: point.v,
        depth: point.depth,
        residual,
        leave_one_out: tested
            .as_ref()
            .and_then(|(errors, _)| errors.get(index).copied())
            .filter(|error| error.is_finite()),
        standard_deviation: found.deviations.as_ref().and_then(|map| at(map, point)),
        outlier: match &tested {
            None => OutlierTest::NotRun,
            Some((_, outliers)) => outliers
                .get(&index)
                .map_or(OutlierTest::Inlier(false), |p| OutlierTest::Outlier(*p)),
        },
    };
    used.map(point).collect()
}

/// The value of a map at the pixel of a point.
fn at(map: &DepthMap, point: &Observation) -> Option<f32> {
    map.get(point.u.round() as usize, point.v.round() as usize)
}
