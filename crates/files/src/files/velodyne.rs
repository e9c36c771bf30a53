//! Laser scans in the formats of KITTI and nuScenes: float32 records without a header.

use super::PointVisitor;
use crate::error::{Error, Result};
use std::path::Path;

/// Visits every point: x, y, z, intensity and, in nuScenes' `.pcd.bin`, the ring index.
pub(super) fn read_velodyne(path: &Path, visit: &mut PointVisitor<'_>) -> Result<()> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let with_ring = path
        .file_stem()
        .is_some_and(|stem| super::has_ending(stem.as_ref(), "pcd"));
    let columns = if with_ring { 5 } else { 4 };
    let (words, rest) = bytes.as_chunks::<4>();
    let values: Vec<f32> = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
    let records = values.chunks_exact(columns);
    // Implausible intensities indicate another kind of file.
    let intense = |record: &[f32]| (0.0..=255.0).contains(&record[3]);
    let is_scan = rest.is_empty() && records.remainder().is_empty() && !values.is_empty();
    if !is_scan || !records.clone().all(intense) {
        let what = format!("is no laser scan of {columns} float32 a point");
        return Err(Error::format(path, what).hint(
            "`.bin` is x, y, z, intensity as in KITTI, `.pcd.bin` has rings as in nuScenes",
        ));
    }
    for record in records {
        visit([record[0], record[1], record[2]].map(f64::from));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_are_records_of_four_or_five_floats() {
        let folder = tempfile::tempdir().unwrap();
        let read = |name: &str, values: &[f32]| {
            let path = folder.path().join(name);
            let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            std::fs::write(&path, bytes).unwrap();
            let mut points = Vec::new();
            read_velodyne(&path, &mut |point| points.push(point)).map(|()| points)
        };
        let found = read("a.bin", &[1.0, -2.0, 3.0, 0.5, 4.0, 5.0, 6.0, 0.0]).unwrap();
        assert_eq!(found, [[1.0, -2.0, 3.0], [4.0, 5.0, 6.0]]);
        let rings = [1.0, -2.0, 3.0, 200.0, 7.0];
        assert_eq!(read("a.pcd.bin", &rings).unwrap(), [[1.0, -2.0, 3.0]]);
        assert!(read("b.bin", &rings).is_err(), "a length of other records");
        let shifted = [rings, rings, rings, [1.0, -2.0, 3.0, 4.0, 5.0]].concat();
        assert!(read("b.bin", &shifted).is_err(), "a negative intensity");
    }
}
