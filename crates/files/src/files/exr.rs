//! `OpenEXR` images with depths: any part, any channel whose name denotes depth, placed in the display window.

use super::{check_pixels, check_unfolded, plausible, write_atomically};
use crate::DepthMap;
use crate::checks::{NumberType, Warning, channel_rank, name_warning, quoted};
use crate::error::{Cause, Error, Result};
use crate::raster::Raster;
use exr::meta::MetaData;
use exr::meta::attribute::IntegerBounds;
use exr::prelude::{
    AnyChannel, AnyChannels, FlatSamples, Image, Layer, ReadChannels as _, ReadLayers as _, Vec2,
    WritableImage as _, read,
};
use std::io::Cursor;
use std::path::Path;

/// Name of the channel of standard deviations.
const SIGMA: &str = "sigma";

/// Names of single channels that are read in the absence of colour: luminance, and the value pass of Blender.
const VALUES: [&str; 2] = ["Y", "V"];

/// Size of a display window that is accepted for any file, in bytes: 4K.
const DISPLAY: u64 = 32 << 20;

type Part = Layer<AnyChannels<FlatSamples>>;

/// A channel of a part.
struct Channel<'a> {
    part: &'a Part,
    samples: &'a AnyChannel<FlatSamples>,
    /// Name, with that of the part if there are several.
    name: String,
}

/// Reads the channel of depths, and the channel of standard deviations of the same part, if it has one.
pub(crate) fn read_exr(path: &Path) -> Result<(Raster, Option<Raster>)> {
    let damaged = |e: exr::error::Error| {
        Error::format(path, "is not a readable EXR")
            .because(e)
            .hint("check that the file is complete; deep data are not read")
    };
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let length = bytes.len() as u64;
    let meta = MetaData::read_from_buffered(Cursor::new(&bytes), true).map_err(damaged)?;
    let mut total = 0_u64;
    for header in &meta.headers {
        let pixels = header.layer_size.area() as u64;
        let each = header.channels.bytes_per_pixel as u64;
        let Vec2(width, height) = header.layer_size;
        let size = (width as u32, height as u32);
        total = total.saturating_add(pixels.saturating_mul(each));
        check_pixels(path, size, total, length)?;
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(&bytes))
        .map_err(damaged)?;
    let channels = channels(&image.layer_data);
    let Some(depths) = depths(&channels) else {
        let names: Vec<String> = channels.into_iter().map(|channel| channel.name).collect();
        let what = format!("no depth channel. Channels: {}", quoted(&names));
        return Err(Error::format(path, what).hint("call the channel of depths Z or depth"));
    };
    let display = image.attributes.display_window;
    let mut raster = depths.raster(path, display, length)?;
    let sigma = depths
        .part
        .channel_data
        .list
        .iter()
        .find(|other| other.name.eq(SIGMA));
    let sigma = sigma.map(|samples| Channel {
        samples,
        name: SIGMA.to_owned(),
        ..*depths
    });
    let sigma = sigma
        .map(|sigma| sigma.raster(path, display, length))
        .transpose()?;
    let warning = name_warning(&depths.name, || {
        format!("a channel called `{}`", depths.name)
    });
    raster.warnings.extend(warning);
    let is_sigma =
        |other: &Channel<'_>| std::ptr::eq(other.part, depths.part) && other.samples.name.eq(SIGMA);
    let others = channels
        .iter()
        .filter(|other| !std::ptr::eq(*other, depths) && !is_sigma(other));
    let others = others.map(|other| other.name.clone()).collect();
    let warning = Warning::chosen("channel", format!("`{}`", depths.name), others);
    raster.warnings.extend(warning);
    Ok((raster, sigma))
}

/// Returns all channels of all parts.
fn channels(parts: &[Part]) -> Vec<Channel<'_>> {
    let several = parts.len() > 1;
    let mut channels = Vec::new();
    for (number, part) in parts.iter().enumerate() {
        let own = part.attributes.layer_name.as_ref().map(ToString::to_string);
        for channel in &part.channel_data.list {
            let name = channel.name.to_string();
            let part_name = own.clone().unwrap_or_else(|| format!("part {number}"));
            // The name of a part is often the prefix of its channels.
            let name = if !several || name.starts_with(&part_name) {
                name
            } else {
                format!("{part_name}.{name}")
            };
            channels.push(Channel {
                part,
                samples: channel,
                name,
            });
        }
    }
    channels
}

/// Returns the channel whose name denotes depth best; else the only channel, a channel of values without colour, or the
/// first of equal R, G and B.
fn depths<'a, 'b>(channels: &'b [Channel<'a>]) -> Option<&'b Channel<'a>> {
    let has_sibling = |name: &str, last: char| {
        let prefix = name.strip_suffix(['z', 'Z']);
        prefix
            .map(|prefix| format!("{prefix}{last}"))
            .is_some_and(|sibling| {
                let mut names = channels.iter().map(|other| &other.name);
                names.any(|name| name.eq_ignore_ascii_case(&sibling))
            })
    };
    let rank = |channel: &Channel<'_>| {
        let rank = channel_rank(&channel.name)?;
        // X, Y and Z are coordinates, normals or velocities.
        let vector = has_sibling(&channel.name, 'x') && has_sibling(&channel.name, 'y');
        let says_more = channel_rank(channel.name.trim_end_matches(['z', 'Z'])).is_some();
        (!vector || says_more || channel.name.len() == 1).then_some((vector, rank))
    };
    let ranked = channels
        .iter()
        .filter_map(|channel| Some((rank(channel)?, channel)));
    if let Some((_, best)) = ranked.min_by_key(|(rank, _)| *rank) {
        return Some(best);
    }
    if let [only] = channels {
        return Some(only);
    }
    let called = |name: &str| {
        channels
            .iter()
            .find(|channel| channel.samples.name.eq(name))
    };
    let [red, green, blue] = ["R", "G", "B"].map(called);
    let colour = red.or(green).or(blue).or_else(|| called("RY"));
    if colour.is_none() {
        return VALUES.iter().find_map(|name| called(name));
    }
    let samples =
        |channel: Option<&Channel<'_>>| channel.map(|channel| channel.samples.sample_data.clone());
    let (first, second, third) = (samples(red)?, samples(green)?, samples(blue)?);
    (first == second && second == third)
        .then_some(red)
        .flatten()
}

impl Channel<'_> {
    /// Returns the values, with the data window placed in the display window.
    fn raster(&self, path: &Path, display: IntegerBounds, length: u64) -> Result<Raster> {
        let Vec2(width, height) = self.part.size;
        let samples = &self.samples.sample_data;
        if samples.len() != width * height {
            let what = format!("channel `{}` has fewer samples than pixels", self.name);
            return Err(Error::format(path, what).hint("write the depths at full resolution"));
        }
        let numbers = match samples {
            FlatSamples::U32(_) => NumberType::unsigned(32),
            FlatSamples::F16(_) | FlatSamples::F32(_) => NumberType::Floats,
        };
        let values: Vec<f32> = samples.values_as_f32().collect();
        let Vec2(left, top) = self.part.attributes.layer_position - display.position;
        let Vec2(across, down) = display.size;
        if (left, top) == (0, 0) && (across, down) == (width, height) {
            return Ok(Raster::new((width, height), values, numbers));
        }
        let bytes = (across as u64)
            .saturating_mul(down as u64)
            .saturating_mul(4);
        let what = format!("the display window of {across}x{down} pixels");
        check_unfolded(
            path,
            &what,
            bytes,
            if plausible(bytes, length) {
                u64::MAX
            } else {
                DISPLAY
            },
        )?;
        let (left, top) = (i64::from(left), i64::from(top));
        let mut placed = vec![0.0; across * down];
        let mut inside = 0;
        for (y, row) in (top..).zip(values.chunks_exact(width)) {
            for (x, &value) in (left..).zip(row) {
                let position = (usize::try_from(x), usize::try_from(y));
                if let (Ok(x), Ok(y)) = position
                    && x < across
                    && y < down
                {
                    placed[y * across + x] = value;
                    inside += 1;
                }
            }
        }
        let mut raster = Raster::new((across, down), placed, numbers);
        raster.warnings.push(Warning::Window {
            window: [left, top, width as i64, height as i64],
            picture: (across, down),
            outside: width * height - inside,
        });
        Ok(raster)
    }
}

/// Writes depths in metres as channel Z, 32-bit floats, and standard deviations as channel sigma.
///
/// # Errors
/// The file cannot be written.
pub fn write_exr(path: &Path, depth: &DepthMap, sigma: Option<&DepthMap>) -> Result<()> {
    let bytes = encode_exr(depth, sigma)?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// Returns the bytes of the file that [`write_exr`] writes.
///
/// # Errors
/// The maps differ in size.
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

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{Encoding, ImageAttributes, LayerAttributes, Text};

    /// A part to write: its name, position, and channels with their first values.
    type Written<'a> = (&'a str, (i32, i32), &'a [(&'a str, f32)]);

    /// Writes parts, each with a name, a position and channels of 2x2 values, into a display window.
    fn write(parts: &[Written<'_>], display: (usize, usize)) -> tempfile::NamedTempFile {
        let layer = |(name, position, channels): &Written<'_>| {
            let list = channels.iter().map(|(name, first)| {
                let values = (0..4).map(|i| first + i as f32).collect();
                AnyChannel::new(*name, FlatSamples::F32(values))
            });
            let mut attributes = LayerAttributes::named(Text::from(*name));
            attributes.layer_position = Vec2(position.0, position.1);
            let list = AnyChannels::sort(list.collect());
            Layer::new((2, 2), attributes, Encoding::UNCOMPRESSED, list)
        };
        let bounds = IntegerBounds::new((0, 0), display);
        let layers: Vec<_> = parts.iter().map(layer).collect();
        let image = Image::from_layers(ImageAttributes::new(bounds), layers);
        let file = tempfile::Builder::new().suffix(".exr").tempfile().unwrap();
        image.write().non_parallel().to_file(file.path()).unwrap();
        file
    }

    fn read_one(channels: &[(&str, f32)]) -> Result<(Raster, Option<Raster>)> {
        read_exr(write(&[("only", (0, 0), channels)], (2, 2)).path())
    }

    #[test]
    fn a_data_window_is_placed_in_the_display_window() {
        let file = write(&[("only", (1, 2), &[("Z", 5.0)])], (4, 3));
        let (found, _) = read_exr(file.path()).unwrap();
        assert_eq!((found.columns, found.rows), (4, 3));
        let mut expected = [0.0; 12];
        expected[9..11].copy_from_slice(&[5.0, 6.0]);
        assert_eq!(found.values, expected);
        let window = Warning::Window {
            window: [1, 2, 2, 2],
            picture: (4, 3),
            outside: 2,
        };
        assert_eq!(found.warnings, [window]);
        // Larger than the display window, as renders with overscan are.
        let file = write(&[("only", (-1, -1), &[("Z", 5.0)])], (1, 1));
        assert_eq!(read_exr(file.path()).unwrap().0.values, [8.0]);
    }

    #[test]
    fn the_channel_that_says_depth_is_read_and_named() {
        for (channels, first) in [
            (&[("R", 1.0), ("G", 2.0), ("Z", 7.0)][..], 7.0),
            (
                &[("ViewLayer.Combined.R", 1.0), ("ViewLayer.Depth.Z", 7.0)],
                7.0,
            ),
            (
                &[
                    ("L.Normal.X", 1.0),
                    ("L.Normal.Y", 2.0),
                    ("L.Normal.Z", 3.0),
                    ("L.Depth.Z", 7.0),
                ],
                7.0,
            ),
            (&[("Depth.V", 7.0), ("Combined.R", 1.0)], 7.0),
            (&[("A", 1.0), ("Y", 7.0)], 7.0),
            (&[("R", 7.0)], 7.0),
            (&[("B", 7.0), ("G", 7.0), ("R", 7.0)], 7.0),
        ] {
            let (found, _) = read_one(channels).unwrap();
            assert_eq!(found.values[0], first, "{channels:?}");
            assert_eq!(
                found.warnings.len(),
                usize::from(channels.len() > 1),
                "{channels:?}"
            );
        }
        let (found, sigma) = read_one(&[("Z", 7.0), ("sigma", 1.0)]).unwrap();
        assert_eq!((found.warnings.len(), sigma.unwrap().values[0]), (0, 1.0));
        let (found, _) = read_one(&[("distance", 7.0)]).unwrap();
        assert!(matches!(found.warnings[..], [Warning::RayDistance { .. }]));
    }

    #[test]
    fn parts_are_searched_for_depth() {
        let parts = [
            ("colour", (0, 0), &[("R", 1.0), ("G", 2.0)][..]),
            ("depth", (1, 0), &[("V", 7.0)]),
        ];
        let (found, _) = read_exr(write(&parts, (3, 2)).path()).unwrap();
        assert_eq!(found.values, [0.0, 7.0, 8.0, 0.0, 9.0, 10.0]);
        assert_eq!(found.warnings.len(), 2, "{:?}", found.warnings);
    }

    #[test]
    fn colour_is_no_depth() {
        let error = read_one(&[("R", 1.0), ("G", 2.0), ("B", 3.0)]).unwrap_err();
        assert!(
            error
                .to_string()
                .contains("no depth channel. Channels: `B`, `G`, `R`"),
            "{error}"
        );
        let error = read_one(&[("N.X", 1.0), ("N.Y", 2.0), ("N.Z", 3.0)]).unwrap_err();
        assert!(error.to_string().contains("no depth channel"), "{error}");
    }

    #[test]
    fn a_file_that_was_cut_off_is_refused() {
        let depth =
            DepthMap::new(40, 30, (0..1200).map(|i| 1.0 + (i as f32).sin()).collect()).unwrap();
        let bytes = encode_exr(&depth, None).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        for share in [0.2, 0.6, 0.95] {
            std::fs::write(&path, &bytes[..(bytes.len() as f64 * share) as usize]).unwrap();
            assert!(read_exr(&path).is_err(), "{share}");
        }
    }
}
