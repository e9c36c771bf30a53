//! What the columns of a table without names are: pixels and depth, or a cloud.

use super::Camera;
use super::files::{Columns, Table};
use super::grid::pixel;
use crate::error::{Error, Result};
use std::path::Path;

/// What every meaning of the columns would make of the points.
struct Evidence {
    /// The share of the points with a positive depth that lie in the image, taken as u, v, depth.
    as_pixels: f64,
    /// The share of all points that the camera sees in the image, taken as x, y, z.
    as_space: f64,
}

/// Decides by the names of the columns, or else by where the points would lie. A table without names
/// holds pixels if there is no camera. With one it is a cloud if most points cannot be pixels, and
/// holds pixels if all of them can and hardly any lies before the camera. Anything else is refused.
pub(super) fn meaning(
    path: &Path,
    table: &Table,
    camera: Option<&Camera>,
    size: (usize, usize),
    metres: f64,
) -> Result<Columns> {
    /// So few points of a list of pixels lie in the image by chance, taken as a cloud.
    const CHANCE: f64 = 0.1;
    if table.columns != Columns::Unnamed {
        return Ok(table.columns);
    }
    let found = Evidence::of(table, camera, size, metres);
    let mostly_pixels = found.as_pixels >= 0.5;
    let (width, height) = size;
    match camera {
        None if mostly_pixels => Ok(Columns::Pixels),
        None => Err(Error::format(
            path,
            format!(
                "{:.0} % of its points lie in the image of {width}x{height} if its columns are u, v, \
                 depth",
                found.as_pixels * 100.0
            ),
        )
        .hint(
            "if they are x, y, z of a cloud, give --camera; if they are pixels, name the columns in \
             the first line: `u,v,depth`",
        )),
        Some(_) if !mostly_pixels && found.as_space > 0.0 => Ok(Columns::Space),
        Some(_) if found.as_pixels == 1.0 && found.as_space < CHANCE => Ok(Columns::Pixels),
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

impl Evidence {
    fn of(table: &Table, camera: Option<&Camera>, size: (usize, usize), metres: f64) -> Self {
        let (mut deep, mut in_image, mut finite, mut seen) = (0_usize, 0_usize, 0_usize, 0_usize);
        for row in &table.rows {
            let [u, v, depth] = row.values;
            if row.values.iter().any(|v| !v.is_finite()) {
                continue;
            }
            finite += 1;
            if depth > 0.0 {
                deep += 1;
                in_image += usize::from(pixel([u, v], size).is_some());
            }
            let place = camera.and_then(|camera| camera.project(row.values.map(|v| v * metres)));
            seen += usize::from(place.is_some_and(|(place, _)| pixel(place, size).is_some()));
        }
        let share = |some: usize, all: usize| some as f64 / all.max(1) as f64;
        Self {
            as_pixels: share(in_image, deep),
            as_space: share(seen, finite),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::files::Row;

    const SIZE: (usize, usize) = (640, 480);

    fn table(points: impl Iterator<Item = [f64; 3]>) -> Table {
        let row = |(number, values)| Row {
            number,
            values,
            fourth: None,
        };
        Table {
            columns: Columns::Unnamed,
            rows: points.enumerate().map(row).collect(),
            row: "row",
        }
    }

    /// Points spread evenly over three ranges.
    fn spread(low: [f64; 3], high: [f64; 3]) -> Table {
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
        // What lies right and below of the axis, near it, could be the first pixels too.
        let corner = spread([0.0, 0.0, 2.0], [0.5, 0.5, 3.0]);
        let decide = |table, camera| meaning(Path::new("a.npy"), table, camera, SIZE, 1.0);
        assert_eq!(decide(&pixels, None).unwrap(), Columns::Pixels);
        assert_eq!(decide(&pixels, Some(&camera)).unwrap(), Columns::Pixels);
        assert_eq!(decide(&cloud, Some(&camera)).unwrap(), Columns::Space);
        assert_eq!(decide(&scan, Some(&camera)).unwrap(), Columns::Space);
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
    fn names_need_no_evidence() {
        for columns in [Columns::Pixels, Columns::Space] {
            let named = Table {
                columns,
                ..spread([-1.0; 3], [1.0; 3])
            };
            let found = meaning(Path::new("a.csv"), &named, None, SIZE, 1.0);
            assert_eq!(found.unwrap(), columns);
        }
    }
}
