//! `lsdc view`: the page, on this machine.

use super::args::View;
use super::serve::{bind, failed, serve};
use super::{Exit, ui};
use image::RgbImage;
use lsdc_eval::data::DepthMap;
use lsdc_eval::report::{coloured, usual_range};
use lsdc_files::error::{Error, Result};
use lsdc_serve::{Access, Asset, Config, Demo, Page, Start};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

/// The rendered room of the repository.
const ROOM: Demo = Demo {
    name: "room",
    title: "A rendered room",
    image: Asset {
        name: "rgb.png",
        bytes: include_bytes!("../../assets/room/rgb.png"),
    },
    points: Asset {
        name: "sparse.npy",
        bytes: include_bytes!("../../assets/room/sparse.npy"),
    },
};

pub(super) fn run(args: &View) -> Result<Exit> {
    let named = [&args.image, &args.points, &args.camera];
    let mut files = named.into_iter().flatten();
    if let Some(missing) = files.find(|path| !path.is_file()) {
        let source = std::io::ErrorKind::NotFound.into();
        return Err(Error::read(missing, source));
    }
    if let Some(missing) = args.gallery.iter().find(|path| !path.is_dir()) {
        let what = format!("`{}` is no folder", missing.display());
        return Err(Error::config(what).hint("give a folder of results of `lsdc complete`"));
    }
    // Other users of this machine reach its ports too.
    let token = lsdc_serve::random_token().map_err(failed)?;
    let config = Config {
        access: Access {
            token: Some(token.clone()),
            open: false,
        },
        page: Some(page(args)),
        ..Config::default()
    };
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
    let server = bind(&args.model, &args.encoder, address, config)?;
    let link = format!("http://{}/?token={token}", server.address());
    ui::print(&format!("page      {link}"));
    if !args.no_browser && open::that_detached(&link).is_err() {
        ui::say("no browser was found; open the page by its address");
    }
    ui::say("Ctrl-C ends it");
    serve(server)
}

fn page(args: &View) -> Page {
    let whole = |path: &PathBuf| path.canonicalize().unwrap_or_else(|_| path.clone());
    Page {
        start: Start {
            image: args.image.as_ref().map(whole),
            points: args.points.as_ref().map(whole),
            camera: args.camera.as_ref().map(whole),
        },
        demos: vec![ROOM],
        gallery: args.gallery.iter().map(whole).collect(),
        paint,
    }
}

/// In the colours of `lsdc complete`.
fn paint(depth: &DepthMap) -> RgbImage {
    let (near, far) = usual_range(depth).unwrap_or((0.0, 1.0));
    coloured(depth, near, far)
}
