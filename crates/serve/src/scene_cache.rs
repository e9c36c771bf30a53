//! Scenes that are kept between requests: the least recently used make room, and unused ones expire.

use crate::fault::{Fault, FaultKind};
use crate::frame::InputFrame;
use crate::metrics::{Metrics, Scalar};
use lsdc_core::Scene;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A scene with the image that it was made of.
pub(crate) struct CachedScene {
    pub(crate) frame: InputFrame,
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
pub(crate) struct SceneCache {
    scenes: Mutex<Entries>,
    /// Bytes of all scenes together.
    limit: u64,
    expiry: Duration,
    metrics: Arc<Metrics>,
}

type Entries = HashMap<String, CacheEntry>;

struct CacheEntry {
    scene: Arc<CachedScene>,
    bytes: u64,
    used: Instant,
}

impl SceneCache {
    pub(crate) fn new(limit: u64, expiry: Duration, metrics: Arc<Metrics>) -> Self {
        Self {
            scenes: Mutex::default(),
            limit,
            expiry,
            metrics,
        }
    }

    /// Lifetime of an unused scene.
    pub(crate) fn expiry(&self) -> Duration {
        self.expiry
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        self.scenes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps a scene, and returns its name.
    ///
    /// # Errors
    /// A scene that is larger than all that may be kept.
    pub(crate) fn keep(&self, scene: CachedScene) -> Result<String, Fault> {
        let (width, height) = scene.frame.size();
        let bytes = bytes(width, height);
        if bytes > self.limit {
            let what = "the scene takes more memory than all that are kept together may";
            return Err(Fault::too_large(what).hint("send a smaller image, or use /v1/complete"));
        }
        let name = crate::random_name().ok_or_else(Fault::failed)?;
        let mut scenes = self.lock();
        while total_bytes(&scenes) + bytes > self.limit {
            let oldest = scenes.iter().min_by_key(|(_, entry)| entry.used);
            let Some(oldest) = oldest.map(|(name, _)| name.clone()) else {
                break;
            };
            scenes.remove(&oldest);
        }
        let entry = CacheEntry {
            scene: Arc::new(scene),
            bytes,
            used: Instant::now(),
        };
        scenes.insert(name.clone(), entry);
        self.count(&scenes);
        Ok(name)
    }

    /// A scene by its name, whose time begins anew.
    ///
    /// # Errors
    /// There is none, or no longer.
    pub(crate) fn get(&self, name: &str) -> Result<Arc<CachedScene>, Fault> {
        self.expire(Instant::now());
        let mut scenes = self.lock();
        let entry = scenes.get_mut(name).ok_or_else(gone)?;
        entry.used = Instant::now();
        Ok(entry.scene.clone())
    }

    /// Forgets a scene.
    ///
    /// # Errors
    /// There is none.
    pub(crate) fn remove(&self, name: &str) -> Result<(), Fault> {
        let mut scenes = self.lock();
        let removed = scenes.remove(name);
        self.count(&scenes);
        removed.map(drop).ok_or_else(gone)
    }

    /// Forgets what has not been used for too long.
    pub(crate) fn expire(&self, now: Instant) {
        let mut scenes = self.lock();
        scenes.retain(|_, entry| now.saturating_duration_since(entry.used) < self.expiry);
        self.count(&scenes);
    }

    fn count(&self, scenes: &Entries) {
        self.metrics.set(Scalar::Scenes, scenes.len() as i64);
        self.metrics
            .set(Scalar::SceneBytes, total_bytes(scenes) as i64);
    }
}

fn total_bytes(scenes: &Entries) -> u64 {
    scenes.values().map(|entry| entry.bytes).sum()
}

fn gone() -> Fault {
    Fault::new(FaultKind::NotFound, "there is no such scene, or no longer")
        .hint("post its image to /v1/scenes again")
}
