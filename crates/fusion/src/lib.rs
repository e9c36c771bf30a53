//! Fusion of many depth maps with camera poses into one surface.
//!
//! Every depth is a measurement with a standard deviation. [`Fusion`] averages the signed distances to the measured surfaces in
//! voxels near them (a truncated signed distance function, Curless and Levoy 1996), weighted by the inverse variance of the
//! depths, in a hash table of blocks of voxels (Nießner et al. 2013). [`Mesh`] is the surface at distance 0, extracted by
//! marching cubes.
//!
//! ```
//! # fn main() -> lsdc_fusion::Result<()> {
//! use lsdc_core::{Camera, DepthMap};
//! use lsdc_fusion::{Frame, Fusion, Settings};
//!
//! // A wall two metres in front of the camera.
//! let depth = DepthMap::new(80, 60, vec![2.0; 80 * 60])?;
//! let camera = Camera::pinhole([60.0, 60.0], [39.5, 29.5]);
//! let mut fusion = Fusion::new(Settings { voxel: Some(0.05), ..Settings::default() })?;
//! fusion.integrate(&Frame { depth: &depth, deviation: None, camera: &camera, image: None })?;
//! let mesh = fusion.mesh()?;
//! assert!(mesh.positions.iter().all(|position| (position[2] - 2.0).abs() < 1e-4));
//! assert!(mesh.normals.iter().all(|normal| normal[2] < -0.999));
//! # Ok(())
//! # }
//! ```
//!
//! Work runs on the caller's `rayon` pool; results are bitwise equal for any number of threads.

mod blocks;
mod cells;
mod error;
mod extract;
mod frame;
mod glb;
mod measure;
mod mesh;
mod ply;
mod report;
mod settings;
mod voxel_size;

pub use error::{Error, Result};
pub use frame::Frame;
pub use mesh::{Mesh, Up};
pub use report::{LeftOut, Report};
pub use settings::Settings;
pub use voxel_size::{VoxelSize, voxel_size};

use blocks::Blocks;
use measure::Rays;

/// A truncated signed distance function that integrates frames.
#[derive(Clone, Debug)]
pub struct Fusion {
    settings: Settings,
    /// `None` until the first frame sets the size of the voxels.
    blocks: Option<Blocks>,
    rays: Rays,
    report: Report,
}

impl Fusion {
    /// A signed distance function without measurements.
    ///
    /// # Errors
    /// A [setting](Settings) that is out of range.
    pub fn new(settings: Settings) -> Result<Self> {
        settings.check()?;
        Ok(Self {
            settings,
            blocks: None,
            rays: Rays::default(),
            report: Report::default(),
        })
    }

    /// Adds a frame. The order of frames only affects rounding.
    ///
    /// Without [`Settings::voxel`], the first frame sets the edge length of the voxels ([`voxel_size`]).
    ///
    /// # Errors
    /// Maps of different sizes, an unusable camera or image, a first frame without any usable pixel, or more blocks than
    /// [`Settings::max_memory`] allows. The function is then unchanged.
    pub fn integrate(&mut self, frame: &Frame<'_>) -> Result<()> {
        frame.check()?;
        self.rays.update(frame);
        let edge = match (&self.blocks, self.settings.voxel) {
            (Some(blocks), _) => blocks.edge(),
            (None, Some(edge)) => edge,
            (None, None) => voxel_size(std::slice::from_ref(frame), &self.settings)?.edge,
        };
        let (measurements, left_out) =
            measure::measurements(frame, &self.rays, &self.settings, edge)?;
        let is_first = self.blocks.is_none();
        let blocks = self.blocks.get_or_insert_with(|| Blocks::new(edge));
        if let Err(error) = blocks.allocate(&measurements, self.settings.max_memory) {
            // The next frame may choose another size.
            self.blocks = self.blocks.take().filter(|_| !is_first);
            return Err(error);
        }
        blocks.integrate(&measurements);
        self.report.add(measurements.used, left_out);
        self.report.voxel = edge;
        self.report.blocks = blocks.len();
        self.report.memory = blocks.memory();
        Ok(())
    }

    /// The surface, with normals on the side from which it was seen, and colours if images were given. Only cells whose eight
    /// corners were measured have a surface.
    ///
    /// # Errors
    /// No frame was added, or the surface has more than 2^32 vertices.
    pub fn mesh(&self) -> Result<Mesh> {
        match &self.blocks {
            Some(blocks) => extract::mesh(blocks),
            None => Err(Error::NoFrames),
        }
    }

    /// Statistics of fused and skipped data.
    pub fn report(&self) -> &Report {
        &self.report
    }
}
