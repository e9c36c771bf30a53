//! Scenes that are kept between requests: the least recently used make room, and unused ones expire.

use crate::fault::{Fault, Kind};
use crate::frame::Frame;
use crate::metrics::Metrics;
use lsdc_core::Scene;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A scene with the image that it was made of.
pub(crate) struct CachedScene {
    pub(crate) frame: Frame,
    pub(crate) scene: Scene,
}

/// Bytes of a scene beside its image, once a fit has been made: features, affinities and the factor of its field, on
/// the grid that the network sees, and working memory that comes with it.
const BESIDE: u64 = 48 << 20;
/// Bytes of a pixel: its colours, here and in the scene, and some to spare.
const PIXEL: u64 = 8;

/// About how much memory the scene of an image of this size takes.
pub(crate) fn bytes(width: usize, height: usize) -> u64 {
    BESIDE + PIXEL * width as u64 * height as u64
}

/// The scenes by their names, which cannot be guessed.
pub(crate) struct Scenes {
    shelf: Mutex<SceneCache>,
    most: u64,
    expiry: Duration,
    metrics: Arc<Metrics>,
}

#[derive(Default)]
struct SceneCache {
    scenes: HashMap<String, Entry>,
    bytes: u64,
}

struct Entry {
    kept: Arc<CachedScene>,
    bytes: u64,
    used: Instant,
}

impl Scenes {
    pub(crate) fn new(most: u64, expiry: Duration, metrics: Arc<Metrics>) -> Self {
        Self {
            shelf: Mutex::default(),
            most,
            expiry,
            metrics,
        }
    }

    /// How long an unused scene is kept.
    pub(crate) fn expiry(&self) -> Duration {
        self.expiry
    }

    fn lock(&self) -> MutexGuard<'_, SceneCache> {
        self.shelf.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps a scene, and returns its name.
    ///
    /// # Errors
    /// A scene that is larger than all that may be kept.
    pub(crate) fn keep(&self, kept: CachedScene) -> Result<String, Fault> {
        let (width, height) = kept.frame.size();
        let bytes = bytes(width, height);
        if bytes > self.most {
            let what = "the scene takes more memory than all that are kept together may";
            return Err(Fault::too_large(what).hint("send a smaller image, or use /v1/complete"));
        }
        let name = crate::random_name().ok_or_else(Fault::failed)?;
        let mut shelf = self.lock();
        while shelf.bytes + bytes > self.most {
            let oldest = shelf.scenes.iter().min_by_key(|(_, entry)| entry.used);
            let Some(oldest) = oldest.map(|(name, _)| name.clone()) else {
                break;
            };
            shelf.remove(&oldest);
        }
        shelf.bytes += bytes;
        let entry = Entry {
            kept: Arc::new(kept),
            bytes,
            used: Instant::now(),
        };
        shelf.scenes.insert(name.clone(), entry);
        self.count(&shelf);
        Ok(name)
    }

    /// A scene by its name, whose time begins anew.
    ///
    /// # Errors
    /// There is none, or no longer.
    pub(crate) fn get(&self, name: &str) -> Result<Arc<CachedScene>, Fault> {
        self.expire(Instant::now());
        let mut shelf = self.lock();
        let entry = shelf.scenes.get_mut(name).ok_or_else(gone)?;
        entry.used = Instant::now();
        Ok(entry.kept.clone())
    }

    /// Forgets a scene.
    ///
    /// # Errors
    /// There is none.
    pub(crate) fn remove(&self, name: &str) -> Result<(), Fault> {
        let mut shelf = self.lock();
        let found = shelf.remove(name);
        self.count(&shelf);
        if found { Ok(()) } else { Err(gone()) }
    }

    /// Forgets what has not been used for too long.
    pub(crate) fn expire(&self, now: Instant) {
        let mut shelf = self.lock();
        let old = |entry: &Entry| now.saturating_duration_since(entry.used) >= self.expiry;
        let names = shelf.scenes.iter().filter(|(_, entry)| old(entry));
        let names: Vec<String> = names.map(|(name, _)| name.clone()).collect();
        for name in names {
            shelf.remove(&name);
        }
        self.count(&shelf);
    }

    fn count(&self, shelf: &SceneCache) {
        self.metrics.set_scenes(shelf.scenes.len(), shelf.bytes);
    }
}

impl SceneCache {
    fn remove(&mut self, name: &str) -> bool {
        let found = self.scenes.remove(name);
        self.bytes -= found.as_ref().map_or(0, |entry| entry.bytes);
        found.is_some()
    }
}

fn gone() -> Fault {
    Fault::new(Kind::NotFound, "there is no such scene, or no longer")
        .hint("post its image to /v1/scenes again")
}
