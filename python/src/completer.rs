//! Weights with settings.

use crate::device::on_device;
use crate::error::{ExceptionKind, raised, raised_by_file};
use crate::guide::DepthGuide;
use crate::image::{Colours, copy};
use crate::pool::Pool;
use crate::scene::Scene;
use crate::settings::changed;
use lsdc_core::{NetworkOutput, Weights};
use numpy::{PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::sync::Arc;

/// Source of weights.
#[derive(FromPyObject)]
pub(crate) enum WeightsSource<'py> {
    /// Name of built-in weights.
    Name(String),
    /// Bytes of a weights file.
    Bytes(Bound<'py, PyBytes>),
}

/// A trained network with the settings of the fit.
#[pyclass(frozen, module = "lsdc._native")]
pub(crate) struct Completer {
    inner: lsdc_core::Completer,
    pool: Pool,
    /// Number of trained parameters of the network.
    #[pyo3(get)]
    parameters: usize,
}

#[pymethods]
impl Completer {
    /// `fit` is a JSON object of the settings that differ from those stored with the weights. `threads` is 0 for one per core,
    /// and absent for the pool of the process. `working_size` is width and height.
    #[new]
    fn new(
        py: Python<'_>,
        weights: WeightsSource<'_>,
        fit: Option<&str>,
        working_size: Option<(usize, usize)>,
        threads: Option<usize>,
        device: &str,
    ) -> PyResult<Self> {
        let raised = |error: lsdc_core::Error| raised(py, &error);
        let pool = match threads {
            None => Pool::shared(py)?,
            Some(threads) => Pool::new(py, threads)?,
        };
        let alone = matches!(&weights, WeightsSource::Name(name) if name == "none");
        let weights = match &weights {
            WeightsSource::Bytes(bytes) => {
                let bytes = bytes.as_bytes();
                py.detach(|| Weights::from_bytes(bytes)).map_err(raised)?
            }
            WeightsSource::Name(name) => {
                let name = if alone { "default" } else { name };
                let Some(found) = lsdc_weights::named(name) else {
                    let what = format!("there are no weights `{name}`");
                    return Err(ExceptionKind::Weights.raise(py, &what, None));
                };
                py.detach(|| found.read()).map_err(raised)?
            }
        };
        if alone && device != "cpu" {
            let what = format!("without a network, there is nothing to run on `{device}`");
            return Err(ExceptionKind::Settings.raise(py, &what, Some("leave `device` out")));
        }
        let network = on_device(py, &weights, device)?;
        let encoder = if network.is_some() {
            None
        } else {
            let encoder = pool.install(py, || lsdc_weights::encoder_of(&weights.network))?;
            encoder.map_err(|error| raised_by_file(py, &error))?
        };
        let mut config = weights.fit().map_err(raised)?.unwrap_or_default();
        if let Some(changes) = fit {
            config = changed(config, changes).map_err(|why| {
                ExceptionKind::Settings.raise(py, &format!("the settings of the fit: {why}"), None)
            })?;
        }
        let threads = pool.threads();
        let inner = pool.run(py, || {
            if alone {
                let completer = lsdc_core::Completer::without_network(config)?;
                return match working_size {
                    None => Ok(completer),
                    Some((width, height)) => completer.with_working_size(height, width),
                };
            }
            let mut builder = lsdc_core::Completer::builder(&weights).fit(config);
            if let Some((width, height)) = working_size {
                builder = builder.working_size(height, width);
            }
            if let Some(encoder) = encoder {
                builder = builder.encoder(encoder);
            }
            if let Some(network) = network {
                builder = builder.network(network);
            }
            builder.thread_pool(threads).build()
        })?;
        let inner = pool.install(py, || lsdc_weights::guided_by_head(inner))?;
        let inner = inner.map_err(|error| raised_by_file(py, &error))?;
        let parameters = if alone { 0 } else { weights.parameters() };
        Ok(Self {
            inner,
            pool,
            parameters,
        })
    }

    /// The same completer whose encoder reads images of another size.
    fn with_encoder_side(&self, py: Python<'_>, side: usize) -> PyResult<Self> {
        let inner = self.inner.with_encoder_side(side);
        Ok(Self {
            inner: inner.map_err(|error| raised(py, &error))?,
            pool: self.pool.clone(),
            parameters: self.parameters,
        })
    }

    /// The settings of the fit, as JSON.
    #[getter]
    fn fit(&self) -> String {
        // Plain structs of numbers and names can always be serialised.
        serde_json::to_string(self.inner.fit_config()).unwrap_or_default()
    }

    /// Whether scenes are guided by the depth head of the encoder.
    #[getter]
    fn has_depth_head(&self) -> bool {
        self.inner.has_depth_head()
    }

    /// Number of threads of the pool.
    #[getter]
    fn threads(&self) -> usize {
        self.pool.count()
    }

    /// `output` contains basis functions `(functions, height, width)` and affinities `(2, height, width)` computed by another
    /// program. Without `guide`, scenes are guided by the depth head of the encoder, if it is installed and `own_guide` is set.
    fn scene(
        &self,
        py: Python<'_>,
        colours: Colours<'_>,
        bgr: bool,
        output: Option<(PyReadonlyArray3<'_, f32>, PyReadonlyArray3<'_, f32>)>,
        guide: Option<&DepthGuide>,
        own_guide: bool,
    ) -> PyResult<Scene> {
        let image = colours.image(py, bgr)?;
        let output = output
            .map(|(basis, affinities)| {
                let (height, width) = (basis.shape()[1], basis.shape()[2]);
                let [basis, affinities] = [basis.as_slice()?, affinities.as_slice()?];
                // Copied, because arrays may be modified while other threads compute.
                let (basis, affinities) = (basis.to_vec(), affinities.to_vec());
                let output = NetworkOutput::new(width, height, basis, affinities);
                output.map_err(|error| raised(py, &error))
            })
            .transpose()?;
        let guide = guide.map(|guide| guide.0.clone());
        let scene = self.pool.run(py, || {
            let scene = match (&output, &guide) {
                (Some(output), guide) => {
                    let scene = self.inner.scene_with_output(&image, output)?;
                    scene.with_guide(guide.as_ref())
                }
                (None, Some(guide)) => self.inner.guided_scene(&image, guide)?,
                (None, None) if own_guide => self.inner.scene(&image)?,
                (None, None) => self.inner.without_depth_head().scene(&image)?,
            };
            Ok((scene, Arc::new(copy(&image)?)))
        });
        let (scene, colours) = scene?;
        Ok(Scene::new(scene, colours, self.pool.clone()))
    }

    /// Returns the image as input of exported weights, `(3, height, width)`.
    fn network_input<'py>(
        &self,
        py: Python<'py>,
        colours: Colours<'_>,
        bgr: bool,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let image = colours.image(py, bgr)?;
        let input = self.pool.run(py, || self.inner.network_input(&image))?;
        let shape = [3, input.height, input.width];
        PyArray1::from_vec(py, input.values).reshape(shape)
    }
}
