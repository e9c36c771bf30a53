//! The meaning of the columns of a table without names: pixels and depth, or a cloud.

use super::Camera;
use super::files::{ColumnMeaning, PointTable};
use super::grid::pixel;
use crate::error::{Error, Result};
use std::path::Path;

/// Evidence for each meaning of the columns.
struct ColumnEvidence {
    /// Share of the points with a positive depth that are in the image, taken as u, v, depth.
    as_pixels: f64,
    /// Share of all points that the camera sees in the image, taken as x, y, z.
    as_space: f64,
    /// Whether the first two columns are integers, as pixels are and coordinates are not.
    whole: bool,
    /// Extent of the points in the image, taken as u, v, depth: the larger of the shares of its width and height. The
    /// extent of few points is measured from the first pixel, near which clouds in metres lie.
    spread: f64,
}

/// Determines the meaning of the columns by their names, or else by the positions of the points. Without a camera, an
/// unnamed table contains pixels if nearly all points are in the image and spread over it. With a camera, it is a cloud if
/// most points cannot be pixels, and contains pixels if all points can be and hardly any is in front of the camera.
/// Anything else is rejected.
pub(super) fn meaning(
    path: &Path,
    table: &PointTable,
    camera: Option<&Camera>,
    size: (usize, usize),
    metres: f64,
) -> Result<ColumnMeaning> {
    /// Largest share of pixel rows that fall into the image by chance when taken as a cloud.
    const CHANCE: f64 = 0.1;
    /// Keypoints may be slightly outside an undistorted or cropped image.
    const NEARLY_ALL: f64 = 0.95;
    /// Largest extent of a cloud in metres, taken as pixels: a room extends over 1 or 2 % of an image.
    const CROWDED: f64 = 0.1;
    match table.columns {
        ColumnMeaning::Unnamed => {}
        ColumnMeaning::Outliers => {
            return Err(Error::format(
                path,
                "is a list of outliers: points that disagree with the others",
            )
            .hint(
                "give the points that it was made from, with --robust auto; to use the list all the same, leave all \
                 columns out but u, v and depth",
            ));
        }
        named => return Ok(named),
    }
    let found = ColumnEvidence::of(table, camera, size, metres);
    let mostly_pixels = found.as_pixels >= 0.5;
    let in_image = found.as_pixels >= NEARLY_ALL;
    let crowded = !found.whole && found.spread < CROWDED;
    let (width, height) = size;
    match camera {
        None if in_image && !crowded => Ok(ColumnMeaning::Pixels),
        None => Err(Error::format(
            path,
            format!(
                "{:.0} % of its points lie in the image of {width}x{height} if its columns are u, v, \
                 depth{}",
                found.as_pixels * 100.0,
                if in_image && crowded {
                    ", crowded in a spot as those of a cloud"
                } else {
                    ""
                }
            ),
        )
        .hint(
            "if they are x, y, z of a cloud, give --camera; if they are pixels, name the columns in \
             the first line: `u,v,depth`",
        )),
        Some(_) if !mostly_pixels && found.as_space > 0.0 => Ok(ColumnMeaning::Space),
        Some(_) if found.as_pixels == 1.0 && found.as_space < CHANCE => Ok(ColumnMeaning::Pixels),
        Some(_) => Err(Error::format(
            path,
            format!(
                "its columns may be u, v, depth ({:.0} % of the points lie in the image) or x, y, z \
                 ({:.0} %)",
                found.as_pixels * 100.0,
                found.as_space * 100.0
            ),
        )
        .hint(
            "name the columns in a first line, `u,v,depth` or `x,y,z`; a cloud may also end in .xyz \
             or .ply, and pixels need no --camera",
        )),
    }
}

impl ColumnEvidence {
    fn of(table: &PointTable, camera: Option<&Camera>, size: (usize, usize), metres: f64) -> Self {
        /// This few points may be all the points of an image, wherever they are.
        const FEW: usize = 8;
        let (mut deep, mut in_image, mut finite, mut seen) = (0_usize, 0_usize, 0_usize, 0_usize);
        let mut whole = true;
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for row in &table.rows {
            let [u, v, depth] = row.values;
            if row.values.iter().any(|v| !v.is_finite()) {
                continue;
            }
            finite += 1;
            if depth > 0.0 {
                deep += 1;
                in_image += usize::from(pixel([u, v], size).is_some());
                whole &= u.fract() == 0.0 && v.fract() == 0.0;
                low = [low[0].min(u), low[1].min(v)];
                high = [high[0].max(u), high[1].max(v)];
            }
            let position = camera.and_then(|camera| camera.project(row.values.map(|v| v * metres)));
            seen +=
                usize::from(position.is_some_and(|(position, _)| pixel(position, size).is_some()));
        }
        if deep < FEW {
            low = low.map(|v| v.min(0.0));
        }
        let share = |some: usize, all: usize| some as f64 / all.max(1) as f64;
        let span = |axis: usize, length: usize| (high[axis] - low[axis]) / length.max(1) as f64;
        Self {
            as_pixels: share(in_image, deep),
            as_space: share(seen, finite),
            whole,
            spread: span(0, size.0).max(span(1, size.1)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::TableRow;

    const SIZE: (usize, usize) = (640, 480);

    fn table(points: impl Iterator<Item = [f64; 3]>) -> PointTable {
        let row = |(number, values)| TableRow {
            number,
            values,
            fourth: None,
        };
        PointTable {
            columns: ColumnMeaning::Unnamed,
            rows: points.enumerate().map(row).collect(),
            row: "row",
        }
    }

    /// Points spread evenly over three ranges.
    fn spread(low: [f64; 3], high: [f64; 3]) -> PointTable {
        table((0..1000).map(|i| {
            let share = |step: usize| (i * step % 1000) as f64 / 999.0;
            let shares = [share(1), share(37), share(211)];
            [0, 1, 2].map(|axis| low[axis] + shares[axis] * (high[axis] - low[axis]))
        }))
    }

    #[test]
    fn where_points_would_lie_tells_clouds_from_pixels() {
        let camera = Camera::pinhole([500.0; 2], [319.5, 239.5]);
        let pixels = spread([0.0, 0.0, 1.0], [639.0, 479.0, 8.0]);
        let cloud = spread([-3.0, -2.0, 2.0], [3.0, 2.0, 8.0]);
        let scan = spread([-40.0, -40.0, -2.0], [40.0, 40.0, 5.0]);
        // Points close to the axis, to its lower right, could also be the first pixels.
        let corner = spread([0.0, 0.0, 2.0], [0.5, 0.5, 3.0]);
        let decide = |table, camera| meaning(Path::new("a.npy"), table, camera, SIZE, 1.0);
        assert_eq!(decide(&pixels, None).unwrap(), ColumnMeaning::Pixels);
        assert_eq!(
            decide(&pixels, Some(&camera)).unwrap(),
            ColumnMeaning::Pixels
        );
        assert_eq!(decide(&cloud, Some(&camera)).unwrap(), ColumnMeaning::Space);
        assert_eq!(decide(&scan, Some(&camera)).unwrap(), ColumnMeaning::Space);
        for (table, camera) in [(&corner, Some(&camera)), (&cloud, None), (&scan, None)] {
            let error = decide(table, camera).unwrap_err();
            assert!(
                error
                    .advice()
                    .is_some_and(|hint| hint.contains("u,v,depth"))
            );
        }
    }

    #[test]
    fn without_a_camera_a_cloud_is_not_taken_for_pixels() {
        let decide = |table: &PointTable| meaning(Path::new("a.npy"), table, None, SIZE, 1.0);
        for (name, cloud) in [
            ("corner", spread([0.0, 0.0, 2.0], [0.5, 0.5, 3.0])),
            ("table top", spread([-0.5, -0.5, 0.4], [0.5, 0.5, 1.0])),
            (
                "forward scan",
                spread([5.0, -10.0, -2.0], [40.0, 10.0, 2.0]),
            ),
            ("its left half", spread([5.0, 0.0, -2.0], [40.0, 10.0, 2.0])),
            (
                "far from its origin",
                spread([300.2, 200.1, 1.0], [310.7, 207.3, 4.0]),
            ),
            ("one point", table([[0.21, -0.13, 0.8]].into_iter())),
        ] {
            let error = decide(&cloud).unwrap_err();
            let hint = error.advice().unwrap_or_default();
            assert!(
                hint.contains("--camera") && hint.contains("u,v,depth"),
                "{name}"
            );
        }
        // A few points may be anywhere, a sensor may see a spot, a laser a line, and keypoints may be slightly outside.
        for (name, pixels) in [
            ("one point", table([[320.5, 240.25, 2.0]].into_iter())),
            ("the first pixel", table([[0.0, 0.0, 2.0]].into_iter())),
            (
                "a marker",
                table([[311.5, 80.5, 2.0], [312.5, 81.5, 2.1]].into_iter()),
            ),
            ("a spot", spread([280.5, 200.5, 1.0], [360.5, 280.5, 2.0])),
            ("a line", spread([0.5, 239.5, 1.0], [638.5, 239.5, 8.0])),
            ("keypoints", spread([-8.5, -6.5, 1.0], [642.5, 482.5, 8.0])),
        ] {
            assert_eq!(decide(&pixels).unwrap(), ColumnMeaning::Pixels, "{name}");
        }
        // Without depths there is no evidence.
        assert!(decide(&table([[1.0, 1.0, 0.0]].into_iter())).is_err());
    }

    #[test]
    fn outliers_are_no_points_to_fit() {
        let outliers = PointTable {
            columns: ColumnMeaning::Outliers,
            ..spread([0.0, 0.0, 1.0], [639.0, 479.0, 8.0])
        };
        let error = meaning(Path::new("a.csv"), &outliers, None, SIZE, 1.0).unwrap_err();
        assert!(error.to_string().contains("list of outliers"), "{error}");
        assert!(error.advice().unwrap().contains("--robust auto"));
    }

    #[test]
    fn names_need_no_evidence() {
        for columns in [ColumnMeaning::Pixels, ColumnMeaning::Space] {
            let named = PointTable {
                columns,
                ..spread([-1.0; 3], [1.0; 3])
            };
            let found = meaning(Path::new("a.csv"), &named, None, SIZE, 1.0);
            assert_eq!(found.unwrap(), columns);
        }
    }
}
