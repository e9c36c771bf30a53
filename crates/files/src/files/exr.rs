//! `OpenEXR` images with depths.

use super::{check_pixels, write_atomically};
use crate::DepthMap;
use crate::error::{Cause, Error, Result};
use exr::meta::MetaData;
use exr::prelude::{
    AnyChannel, AnyChannels, FlatSamples, Image, ReadChannels as _, ReadLayers as _, Vec2,
    WritableImage as _, read,
};
use std::io::Cursor;
use std::path::Path;

/// What the channel of depths is called, the first that is there counts; a single channel may have
/// any name.
const DEPTHS: [&str; 7] = ["Z", "depth", "Depth", "Y", "V", "R", "distance"];
/// What that of standard deviations is called.
const SIGMA: &str = "sigma";

/// Reads the first layer: metres = value x `scale`; and its standard deviations, if it has them.
pub(crate) fn read_exr(path: &Path, scale: f64) -> Result<(DepthMap, Option<DepthMap>)> {
    let damaged = |e: exr::error::Error| Error::format(path, "is not a readable EXR").because(e);
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let meta = MetaData::read_from_buffered(Cursor::new(&bytes), true).map_err(damaged)?;
    for header in &meta.headers {
        let pixels = header.layer_size.area() as u64;
        let each = header.channels.bytes_per_pixel as u64;
        let Vec2(width, height) = header.layer_size;
        let size = (width as u32, height as u32);
        let length = bytes.len() as u64;
        check_pixels(path, size, pixels.saturating_mul(each), length)?;
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(&bytes))
        .map_err(damaged)?;
    let Vec2(width, height) = image.layer_data.size;
    let channels = &image.layer_data.channel_data.list;
    let find = |name: &str| channels.iter().find(|c| c.name.eq(name));
    let only = channels.first().filter(|_| channels.len() == 1);
    let depths = DEPTHS.iter().find_map(|name| find(name)).or(only);
    let depths = depths.ok_or_else(|| {
        let names: Vec<String> = channels.iter().map(|c| c.name.to_string()).collect();
        Error::format(
            path,
            format!("holds channels {names:?}, none of which says depth"),
        )
        .hint("call the channel of depths Z")
    })?;
    let map = |channel: &AnyChannel<FlatSamples>| {
        let values = channel.sample_data.values_as_f32();
        let values = values.map(|v| (f64::from(v) * scale) as f32);
        DepthMap::new(width, height, values.collect())
    };
    Ok((map(depths)?, find(SIGMA).map(map).transpose()?))
}

/// Writes depths in metres as channel Z, 32-bit floats, and standard deviations as channel sigma.
///
/// # Errors
/// The file cannot be written.
pub fn write_exr(path: &Path, depth: &DepthMap, sigma: Option<&DepthMap>) -> Result<()> {
    let bytes = encode_exr(depth, sigma)?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// The bytes of the file that [`write_exr`] writes.
///
/// # Errors
/// Maps of different sizes.
pub fn encode_exr(depth: &DepthMap, sigma: Option<&DepthMap>) -> Result<Vec<u8>> {
    let channel =
        |name: &str, map: &DepthMap| AnyChannel::new(name, FlatSamples::F32(map.values().to_vec()));
    let channels = std::iter::once(channel("Z", depth));
    let channels = channels.chain(sigma.map(|map| channel(SIGMA, map)));
    let image = Image::from_channels(
        (depth.width(), depth.height()),
        AnyChannels::sort(channels.collect()),
    );
    let mut bytes = Cursor::new(Vec::new());
    image
        .write()
        .non_parallel()
        .to_buffered(&mut bytes)
        .map_err(|e| Error::new(Cause::Write, "cannot make an EXR image").because(e))?;
    Ok(bytes.into_inner())
}
