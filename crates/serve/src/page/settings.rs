//! Settings of the page, given by the program that serves it.

use image::RgbImage;
use lsdc_core::DepthMap;
use std::path::PathBuf;

/// Settings of the page.
#[derive(Clone)]
pub struct Page {
    /// The frame shown at the start.
    pub start: Start,
    /// Images to try.
    pub demos: Vec<Demo>,
    /// Folders of results.
    pub gallery: Vec<PathBuf>,
    /// Colours of a depth map, for small pictures.
    pub paint: fn(&DepthMap) -> RgbImage,
}

/// Files that the page opens with.
#[derive(Clone, Debug, Default)]
pub struct Start {
    /// The image.
    pub image: Option<PathBuf>,
    /// Points in it, in any file that is read.
    pub points: Option<PathBuf>,
    /// Its camera.
    pub camera: Option<PathBuf>,
}

/// An image to try, with points.
#[derive(Clone, Debug)]
pub struct Demo {
    /// In addresses: letters and digits.
    pub name: &'static str,
    /// For people.
    pub title: &'static str,
    /// The image.
    pub image: Asset,
    /// The points.
    pub points: Asset,
}

/// A file that is part of the program.
#[derive(Clone, Copy, Debug)]
pub struct Asset {
    /// Its name, whose ending says what it is.
    pub name: &'static str,
    /// What is in it.
    pub bytes: &'static [u8],
}
