//! The systems that the paper compares itself with, beside `lsdc`: trained on the same frames with the same number of
//! steps and images, then measured with the same points, fewer, more, elsewhere, scaled and wrong ones, on other
//! cameras, and at a higher resolution than that of the image.

use super::cell::{Cell, Measured, Progress, Trained, keep_to};
use super::cost::{SIZES, Subject, Timed};
use super::points::axis;
use super::resolution::{LARGE, METRICS as SHARP, POINTS as FEW, SMALL, enlarged};
use super::scale::Scaled;
use super::{Lab, Study, SystemRecipe, published};
use crate::data::{Dataset, DepthMap, Frame, FrameId};
use crate::error::Result;
use crate::eval::{Candidate, Enlargement};
use crate::metrics::{Metric, Scores};
use crate::model::{InitNetwork as _, parameter_count};
use crate::predict::{Classic, Method};
use crate::provenance;
use crate::report::{Chart, Column, Contest, Failure, Line, Row, Section, Table};
use crate::sample::{Noise, Pattern, Preset, Size};
use crate::systems::{Predictor, SystemConfig};
use crate::train::{Event, Outcome, Trainer};
use burn::tensor::Device;
use serde_json::json;
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

const METRICS: [Metric; 5] = [
    Metric::Rmse,
    Metric::Rel,
    Metric::Delta1,
    Metric::Mae,
    Metric::See,
];
/// Numbers of points beside those that the systems are trained with.
const COUNTS: [usize; 5] = [5, 50, 200, 1000, 5000];
/// Points that are not at random.
const PATTERNS: [Pattern; 4] = [
    Pattern::Grid(12),
    Pattern::Lines(16),
    Pattern::Corners(500),
    Pattern::Half(500),
];
const FACTORS: [f32; 2] = [0.1, 10.0];
/// What is wrong with points, in words.
const NOISES: [(&str, &str, Noise); 3] = [
    (
        "up to 1 m added to 30 %",
        "added",
        Noise::Added {
            share: 0.3,
            most: 1.0,
        },
    ),
    ("10 % anywhere", "outliers", Noise::Outliers { share: 0.1 }),
    (
        "as of stereo, 1 % of the square",
        "stereo",
        Noise::Stereo { factor: 0.01 },
    ),
];
/// How much narrower the view of the other camera is.
const NARROWER: usize = 2;
/// What is measured beside, without any training.
const UNTRAINED: [Method; 2] = [
    Method::Classic(Classic::Steering),
    Method::Classic(Classic::Linear),
];
/// The name of our method with the same training.
const SAME: &str = "lsdc, same budget";

/// A system that takes part.
enum Entrant<'a> {
    /// With weights that there are.
    Given(String, Predictor),
    /// Trained by the experiment.
    Trained(TrainedSystem<'a>),
}

impl Entrant<'_> {
    fn name(&self) -> &str {
        match self {
            Self::Given(name, _) => name,
            Self::Trained(cell) => &cell.recipe.name,
        }
    }

    fn config(&self) -> &SystemConfig {
        match self {
            Self::Given(_, predictor) => &predictor.trained().config,
            Self::Trained(cell) => &cell.recipe.system,
        }
    }

    /// Once its weights are there.
    fn predictor(&self, lab: &Lab) -> Result<Option<Predictor>> {
        match self {
            Self::Given(_, predictor) => Ok(Some(predictor.clone())),
            Self::Trained(cell) if !cell.weights().exists() => Ok(None),
            Self::Trained(cell) => Predictor::open(&cell.weights(), &lab.device.0).map(Some),
        }
    }
}

/// All that take part, and our network with the same training.
struct Field<'a> {
    lab: &'a Lab,
    entrants: Vec<Entrant<'a>>,
    same: Option<Trained<'a>>,
}

impl Field<'_> {
    /// Once all weights are there.
    fn predictors(&self) -> Result<Option<Vec<(String, Predictor)>>> {
        if self.same.as_ref().is_some_and(|same| !same.is_trained()) {
            return Ok(None);
        }
        let all = self.entrants.iter().map(|entrant| {
            let predictor = entrant.predictor(self.lab)?;
            Ok(predictor.map(|predictor| (entrant.name().to_owned(), predictor)))
        });
        all.collect()
    }
}

/// How a condition differs from the protocol of the lab.
type Change<'a> = Box<dyn Fn(Measured<'a>) -> Measured<'a> + 'a>;

/// All of them under one condition, once they are trained.
struct Side<'a> {
    field: Rc<Field<'a>>,
    name: String,
    label: String,
    change: Change<'a>,
    /// Whether depth is at a higher resolution than the image.
    sharp: bool,
}

impl<'a> Side<'a> {
    fn new(
        field: &Rc<Field<'a>>,
        name: impl Into<String>,
        label: impl Into<String>,
        change: impl Fn(Measured<'a>) -> Measured<'a> + 'a,
    ) -> Self {
        Self {
            field: field.clone(),
            name: format!("systems-{}", name.into()),
            label: label.into(),
            change: Box::new(change),
            sharp: false,
        }
    }

    /// The measurements of `lsdc` and the systems, and that of our network with the same training.
    fn parts(&self) -> Result<Vec<Measured<'a>>> {
        let Some(predictors) = self.field.predictors()? else {
            return Ok(Vec::new());
        };
        let lab = self.field.lab;
        let from = self.sharp.then_some(SMALL);
        let method = |method: Method| {
            let name = method.name().to_owned();
            match (self.sharp, method) {
                (false, method) => (name, Candidate::Method(method)),
                (true, Method::Lsdc) => enlarged(name, method, Enlargement::Bases),
                (true, method) => enlarged(name, method, Enlargement::Bilinear),
            }
        };
        let systems = predictors
            .into_iter()
            .map(|(name, predictor)| (name, Candidate::System { predictor, from }));
        let candidates = std::iter::once(method(Method::Lsdc))
            .chain(systems)
            .chain(UNTRAINED.map(method));
        let all = Measured::new(lab, &self.name).candidates(candidates.collect());
        let mut parts = vec![(self.change)(all)];
        if let Some(same) = &self.field.same {
            let name = format!("{}-same", self.name);
            let own = method(Method::Lsdc).1;
            let cell = same
                .measured_as(&name)?
                .candidates(vec![(SAME.to_owned(), own)]);
            parts.push((self.change)(cell));
        }
        Ok(parts)
    }

    /// Each method's name and mean scores: `lsdc`, that with the same training, the systems, the untrained.
    fn means(&self) -> Result<Vec<(String, Scores)>> {
        let mut parts = self.parts()?.into_iter();
        let mut means = match parts.next() {
            None => Vec::new(),
            Some(all) => all.means()?,
        };
        for part in parts {
            for mean in part.means()?.into_iter().rev() {
                means.insert(1, mean);
            }
        }
        Ok(means)
    }

    fn show(&self, section: &mut Section, caption: &str, as_name: &str) -> Result<()> {
        if let Some(all) = self.parts()?.first() {
            all.show_as(section, as_name, caption)?;
        }
        Ok(())
    }
}

impl Cell for Side<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn kept(&self) -> Result<usize> {
        self.parts()?.iter().map(Cell::kept).sum()
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        let parts = self.parts()?;
        if parts.is_empty() {
            // Trained later.
            let _ = progress(0.0);
        }
        let count = parts.len() as f64;
        let mut stopped = false;
        for (number, part) in parts.iter().enumerate() {
            part.run(&mut |share| {
                let flow = progress((number as f64 + share) / count);
                stopped |= flow.is_break();
                flow
            })?;
            if stopped {
                break;
            }
        }
        Ok(())
    }

    fn failures(&self) -> Result<Vec<Failure>> {
        let parts = self.parts()?;
        let failures = parts.iter().map(Cell::failures);
        Ok(failures.collect::<Result<Vec<_>>>()?.concat())
    }
}

/// A system trained by the experiment.
struct TrainedSystem<'a> {
    lab: &'a Lab,
    recipe: &'a SystemRecipe,
    name: String,
    frames: Arc<dyn Dataset>,
}

impl TrainedSystem<'_> {
    fn folder(&self) -> PathBuf {
        self.lab.runs().join(&self.name)
    }

    fn weights(&self) -> PathBuf {
        self.folder().join("weights.safetensors")
    }

    fn keep_to_recipe(&self) -> Result<()> {
        keep_to(
            &self.folder(),
            &json!({
                "program": provenance::program(),
                "system": self.recipe.system,
                "training": self.recipe.train,
                "frames": provenance::frames(&*self.frames),
                "place": self.lab.place,
            }),
        )
    }
}

impl Cell for TrainedSystem<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn kept(&self) -> Result<usize> {
        if !self.weights().exists() {
            return Ok(0);
        }
        self.keep_to_recipe().map(|()| 1)
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        self.keep_to_recipe()?;
        if self.weights().exists() {
            let _ = progress(1.0);
            return Ok(());
        }
        let SystemRecipe { system, train, .. } = self.recipe;
        let steps = train.steps as f64;
        let trainer = Trainer::of_system(
            &self.folder(),
            system.clone(),
            train.clone(),
            self.frames.clone(),
            std::slice::from_ref(&self.lab.device.0),
        )?;
        let stop = AtomicBool::new(false);
        let outcome = trainer.run(&stop, |event| {
            if let Event::Step { step, .. } = event
                && progress(*step as f64 / steps).is_break()
            {
                stop.store(true, Ordering::Relaxed);
            }
        })?;
        if outcome == Outcome::Finished {
            let _ = progress(1.0);
        }
        Ok(())
    }
}

/// The time of one of them, once it is trained.
struct Clock<'a> {
    field: Rc<Field<'a>>,
    /// Which of the systems; none: `lsdc`.
    entrant: Option<usize>,
    name: String,
}

impl<'a> Clock<'a> {
    fn timed(&self) -> Result<Option<Timed<'a>>> {
        let lab = self.field.lab;
        let (label, subject) = match self.entrant {
            None => ("lsdc".to_owned(), Subject::Lab { full: false }),
            Some(number) => {
                let Some(predictor) = self.field.entrants[number].predictor(lab)? else {
                    return Ok(None);
                };
                (predictor.trained().hash.clone(), Subject::System(predictor))
            }
        };
        Ok(Some(Timed {
            lab,
            name: self.name.clone(),
            label,
            subject,
            size: SIZES[0],
        }))
    }
}

impl Cell for Clock<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn kept(&self) -> Result<usize> {
        self.timed()?.map_or(Ok(0), |timed| timed.kept())
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        if let Some(timed) = self.timed()? {
            return timed.run(progress);
        }
        let _ = progress(0.0);
        Ok(())
    }
}

pub(super) struct Systems<'a> {
    field: Rc<Field<'a>>,
    trained: Side<'a>,
    counts: Vec<Side<'a>>,
    patterns: Vec<Side<'a>>,
    scales: Vec<Side<'a>>,
    noises: Vec<Side<'a>>,
    cameras: Vec<Side<'a>>,
    sharp: Side<'a>,
    clocks: Vec<Clock<'a>>,
}

impl<'a> Systems<'a> {
    pub(super) fn new(lab: &'a Lab) -> Result<Self> {
        let field = Rc::new(field(lab)?);
        let mut cameras = vec![Side::new(&field, "narrow", "half the view", move |cell| {
            let frames = Narrow(lab.frames.clone());
            cell.on(format!("{}, the middle", lab.dataset), Arc::new(frames))
        })];
        if let Some(diode) = &lab.diode {
            let preset = Preset::named("diode-masked")?;
            cameras.push(Side::new(&field, "diode", "DIODE", move |cell| {
                cell.on("diode val".into(), diode.clone()).protocol(&preset)
            }));
        }
        let counts = COUNTS.map(|count| {
            Side::new(&field, count.to_string(), count.to_string(), move |cell| {
                cell.points(Pattern::Exactly(count))
            })
        });
        let patterns = PATTERNS.map(|pattern| {
            let name = String::from(pattern.clone());
            Side::new(
                &field,
                name.replace(':', "-"),
                pattern.to_string(),
                move |cell| cell.points(pattern.clone()),
            )
        });
        let scales = FACTORS.map(|factor| {
            Side::new(
                &field,
                format!("x{factor}"),
                factor.to_string(),
                move |cell| {
                    let frames = Scaled {
                        frames: lab.frames.clone(),
                        factor,
                    };
                    cell.on(format!("{} x {factor}", lab.dataset), Arc::new(frames))
                },
            )
        });
        let noises = NOISES.map(|(label, name, noise)| {
            Side::new(&field, name, label, move |cell| cell.noise(Some(noise)))
        });
        let sharp = Side {
            sharp: true,
            ..Side::new(&field, "sharp", "", move |cell| {
                let protocol = super::resolution::protocol(lab);
                cell.resized(protocol, "of the experiment")
                    .points(Pattern::Exactly(FEW))
            })
        };
        let clocks = (0..=field.entrants.len()).map(|number| Clock {
            field: field.clone(),
            entrant: number.checked_sub(1),
            name: format!("systems-time-{number}"),
        });
        Ok(Self {
            trained: Side::new(&field, "500", "as trained", |cell| cell),
            counts: counts.into(),
            patterns: patterns.into(),
            scales: scales.into(),
            noises: noises.into(),
            cameras,
            sharp,
            clocks: clocks.collect(),
            field,
        })
    }

    /// Errors with the points of the training, beside what was published.
    fn as_trained(&self, section: &mut Section) -> Result<()> {
        let lab = self.field.lab;
        let means = self.trained.means()?;
        let mut rows: Vec<Row> = means
            .iter()
            .map(|(name, scores)| Row::of(name, scores, &METRICS))
            .collect();
        for system in &published::SYSTEMS {
            for (label, (rmse, rel, delta)) in system.rows {
                let values = vec![Some(*rmse), Some(*rel), *delta, None, None];
                rows.push(published::row(label, values));
            }
        }
        let table = Table {
            title: format!("Errors, {}", lab.preset.points),
            rows_are: "method".into(),
            contest: Contest::Rows,
            columns: METRICS.iter().map(|&m| Column::of(m)).collect(),
            rows,
        };
        section.findings.extend(table.verdict("lsdc"));
        section.tables.push(table);
        for entrant in &self.field.entrants {
            let kind = entrant.config().kind();
            let Some(theirs) = published::SYSTEMS.iter().find(|s| s.kind == kind) else {
                continue;
            };
            let found = means.iter().find(|(name, _)| name == entrant.name());
            let Some((_, scores)) = found else { continue };
            let best = theirs.rows.iter().map(|(_, errors)| errors.0);
            let best = best.fold(f64::MAX, f64::min);
            let here = scores[Metric::Rmse];
            if best < here {
                section.findings.push(format!(
                    "{}: published RMSE {best:.3} m, here {here:.3} m: {}",
                    entrant.name(),
                    Self::why(entrant)
                ));
            }
        }
        Ok(())
    }

    /// Why a published number may be better.
    fn why(entrant: &Entrant<'_>) -> String {
        let start = match entrant.config().pretrained() {
            Some(_) => "an encoder trained on ImageNet",
            None => "random weights, where the authors start from an encoder trained on ImageNet",
        };
        let start = match entrant.config() {
            SystemConfig::Lsk(_) => "random weights",
            _ => start,
        };
        let kind = entrant.config().kind();
        let theirs = published::SYSTEMS.iter().find(|s| s.kind == kind);
        let training = match entrant {
            Entrant::Given(_, predictor) => trained_with(predictor),
            Entrant::Trained(cell) => {
                let train = &cell.recipe.train;
                format!("{} steps of {} images", train.steps, train.batch)
            }
        };
        format!(
            "{training} from {start}; published: {}, on all 654 frames of the official split",
            theirs.map_or("", |s| s.training)
        )
    }

    /// A measure of all methods under some conditions, a column for each method.
    fn table(
        &self,
        sides: &[Side<'a>],
        title: &str,
        rows_are: &str,
        metric: Metric,
    ) -> Result<Table> {
        let mut names = Vec::new();
        let mut rows = Vec::new();
        for side in std::iter::once(&self.trained).chain(sides) {
            let means = side.means()?;
            names = means.iter().map(|(name, _)| name.clone()).collect();
            rows.push(Row {
                label: side.label.clone(),
                aside: false,
                values: means.iter().map(|(_, s)| Some(s[metric])).collect(),
            });
        }
        Ok(Table {
            title: format!("{title}: {}", metric.label()),
            rows_are: rows_are.to_owned(),
            contest: Contest::Columns,
            columns: names.iter().map(|n| Column::named(n, metric)).collect(),
            rows,
        })
    }

    /// Errors against the number of points.
    fn points(&self, section: &mut Section) -> Result<()> {
        let title = "Other numbers of points";
        for metric in [Metric::Rmse, Metric::Rel] {
            let table = self.table(&self.counts, title, "points", metric)?;
            let names = table.columns.iter().map(|column| column.label.clone());
            let lines = names.enumerate().map(|(colour, name)| Line {
                name: Some(name),
                colour,
                dashed: false,
                points: COUNTS
                    .iter()
                    .zip(&table.rows[1..])
                    .filter_map(|(count, row)| Some((*count as f64, row.values[colour]?)))
                    .collect(),
            });
            let chart = Chart {
                title: metric.label(),
                across: "sparse points",
                up: &axis(metric),
                logarithmic: true,
                lines: lines.collect(),
            };
            let caption = format!(
                "{} against the number of points; the systems are trained with one number.",
                metric.label()
            );
            section.show(&format!("points-{}", metric.key()), &caption, chart.draw());
            section.findings.extend(table.verdict("lsdc"));
            section.tables.push(table);
        }
        Ok(())
    }

    /// Depth at three times the resolution of the image.
    fn resolution(&self, section: &mut Section) -> Result<()> {
        let means = self.sharp.means()?;
        let mut rows: Vec<Row> = means
            .iter()
            .map(|(name, scores)| Row::of(name, scores, &SHARP))
            .collect();
        for (name, [rmse, rel]) in published::TABLE_3 {
            let values = vec![Some(rmse), Some(rel), None, None];
            rows.push(published::row(name, values));
        }
        let table = Table {
            title: format!("Image and {FEW} points at {SMALL}, depth at {LARGE}"),
            rows_are: "method".into(),
            contest: Contest::Rows,
            columns: SHARP.iter().map(|&m| Column::of(m)).collect(),
            rows,
        };
        section.findings.extend(table.verdict("lsdc"));
        section.tables.push(table);
        Ok(())
    }

    /// Parameters, and times of a frame.
    fn cost(&self, section: &mut Section) -> Result<()> {
        let column = |label: &str, unit, decimals| Column {
            label: label.to_owned(),
            unit,
            decimals,
            rising: false,
        };
        let megabytes = |parameters: usize| parameters as f64 * 4.0 / 1e6;
        let mut rows = Vec::new();
        for clock in &self.clocks {
            let total = clock.timed()?.map(|timed| timed.total()).transpose()?;
            let (label, parameters, counted) = match clock.entrant {
                None => {
                    let net = self.field.lab.network.init(0, &Device::flex())?;
                    let count = parameter_count(&net);
                    ("lsdc".to_owned(), count, count)
                }
                Some(number) => {
                    let entrant = &self.field.entrants[number];
                    let count = parameter_count(&entrant.config().blank(&Device::flex())?);
                    let counted = count + entrant.config().never_run();
                    (entrant.name().to_owned(), count, counted)
                }
            };
            rows.push(Row {
                label,
                aside: false,
                values: vec![
                    Some(parameters as f64 / 1e6),
                    Some(counted as f64 / 1e6),
                    Some(megabytes(parameters)),
                    total,
                ],
            });
        }
        for (name, parameters, total) in published::TABLE_5 {
            let values = vec![None, Some(parameters), None, Some(total)];
            rows.push(published::row(name, values));
        }
        let Size { height, width } = SIZES[0];
        section.tables.push(Table {
            title: format!("Cost of a frame of {width}x{height}"),
            rows_are: "method".into(),
            contest: Contest::None,
            columns: vec![
                column("parameters", "M", 3),
                column("as counted", "M", 3),
                column("weights", "MB", 1),
                column("total", "ms", 1),
            ],
            rows,
        });
        Ok(())
    }

    fn groups(&self) -> [(&[Side<'a>], &'static str, &'static str, Metric); 4] {
        [
            (&self.patterns, "Other patterns", "points", Metric::Rmse),
            (&self.scales, "Scaled depths", "factor", Metric::Rel),
            (&self.noises, "Wrong points", "what is wrong", Metric::Rmse),
            (&self.cameras, "Other cameras", "camera", Metric::Rel),
        ]
    }
}

impl Study for Systems<'_> {
    fn cells(&self) -> Vec<&dyn Cell> {
        let mut cells: Vec<&dyn Cell> = Vec::new();
        for entrant in &self.field.entrants {
            if let Entrant::Trained(cell) = entrant {
                cells.push(cell);
            }
        }
        cells.extend(self.field.same.as_ref().map(|same| same as &dyn Cell));
        cells.push(&self.trained);
        cells.extend(self.counts.iter().map(|side| side as &dyn Cell));
        for (sides, ..) in self.groups() {
            cells.extend(sides.iter().map(|side| side as &dyn Cell));
        }
        cells.push(&self.sharp);
        cells.extend(self.clocks.iter().map(|clock| clock as &dyn Cell));
        cells
    }

    fn section(&self) -> Result<Section> {
        let lab = self.field.lab;
        let title = "The systems that the paper compares itself with, side by side";
        let mut section = Section::new("systems", title);
        section
            .about
            .push(format!("{} {}.", lab.about(), lab.preset.points));
        for entrant in &self.field.entrants {
            let source = entrant.config().kind().source();
            let how = match entrant {
                Entrant::Given(_, predictor) => trained_with(predictor),
                Entrant::Trained(cell) => format!(
                    "trained here, {} steps of {} images",
                    cell.recipe.train.steps, cell.recipe.train.batch
                ),
            };
            let start = match entrant.config().pretrained() {
                Some(path) => format!("encoder from `{}`", path.display()),
                None => "from random weights".to_owned(),
            };
            section
                .about
                .push(format!("{}: {source}; {how}, {start}.", entrant.name()));
        }
        if self.field.same.is_some() {
            let train = &lab.recipe.train;
            section.about.push(format!(
                "{SAME}: the network of the recipe, trained from random weights for {} steps of {} images as well, with \
                 the plain fit. `lsdc` itself has the weights named above, which were trained for longer.",
                train.steps, train.batch
            ));
        }
        section.about.push(
            "All see the same frames and the same points; predictions of all are kept within ten times the range of \
             the points. An image of another size is resized to that of the training."
                .into(),
        );
        self.as_trained(&mut section)?;
        self.points(&mut section)?;
        for (sides, title, rows_are, metric) in self.groups() {
            let table = self.table(sides, title, rows_are, metric)?;
            section.findings.extend(table.verdict("lsdc"));
            section.tables.push(table);
        }
        self.resolution(&mut section)?;
        self.cost(&mut section)?;
        let caption = "The frame with lsdc's median RMSE, with the points of the training.";
        self.trained.show(&mut section, caption, "frame")?;
        let few = "The same with 50 points.";
        self.counts[1].show(&mut section, few, "frame-50")?;
        let large = "Depth at three times the resolution of the image.";
        self.sharp.show(&mut section, large, "frame-sharp")?;
        section.notes = published::notes(&published::SYSTEMS_NOTES);
        Ok(section)
    }
}

/// Who takes part: the systems that were given, or those that the recipe names, with our network trained alike.
fn field(lab: &Lab) -> Result<Field<'_>> {
    if !lab.systems.is_empty() {
        let given = lab.systems.iter();
        let given = given.map(|(name, predictor)| Entrant::Given(name.clone(), predictor.clone()));
        return Ok(Field {
            lab,
            entrants: given.collect(),
            same: None,
        });
    }
    let frames = (lab.recipe.frames)()?;
    let trained = lab.recipe.systems.iter().map(|recipe| {
        Entrant::Trained(TrainedSystem {
            lab,
            recipe,
            name: format!("systems-{}", recipe.name),
            frames: frames.clone(),
        })
    });
    let network = lab.recipe.network.clone();
    let entrants = trained.collect();
    Ok(Field {
        lab,
        entrants,
        same: Some(Trained::new(lab, "systems-lsdc", network, frames)),
    })
}

/// How weights that were given were trained, in words.
fn trained_with(predictor: &Predictor) -> String {
    let note = predictor.trained().notes.get(crate::train::TRAINING_NOTE);
    let training: Option<serde_json::Value> = note.and_then(|note| serde_json::from_str(note).ok());
    match training {
        Some(training) => format!(
            "given, {} steps of {} images",
            training["steps"], training["batch"]
        ),
        None => "given, trained elsewhere".to_owned(),
    }
}

/// The middle of frames: what a camera with a longer lens sees.
struct Narrow(Arc<dyn Dataset>);

impl Dataset for Narrow {
    fn about(&self) -> String {
        format!("{}, the middle 1/{NARROWER}", self.0.about())
    }

    fn protocol(&self) -> &'static str {
        self.0.protocol()
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.0.id(index)
    }

    fn files(&self, index: usize) -> Vec<PathBuf> {
        self.0.files(index)
    }

    /// Enlarged to the size that it had, so that protocols find what they cut out.
    fn load(&self, index: usize) -> Result<Frame> {
        let frame = self.0.load(index)?;
        let (width, height) = (frame.depth.width(), frame.depth.height());
        // The pixel of the middle part that each pixel shows.
        let from = |i: usize, length: usize| {
            let part = (length / NARROWER).max(1);
            (length - part) / 2 + i * part / length
        };
        let place = |i: usize| from(i / width, height) * width + from(i % width, width);
        let moved = |map: &DepthMap| {
            let values = (0..width * height).map(|i| map.values()[place(i)]);
            DepthMap::new(width, height, values.collect())
        };
        let rgb = image::RgbImage::from_fn(width as u32, height as u32, |x, y| {
            let (x, y) = (from(x as usize, width), from(y as usize, height));
            *frame.rgb.get_pixel(x as u32, y as u32)
        });
        let mask = frame.mask.as_ref();
        Ok(Frame {
            rgb,
            depth: moved(&frame.depth)?,
            sparse: None,
            mask: mask.map(|mask| (0..width * height).map(|i| mask[place(i)]).collect()),
            ..frame
        })
    }
}
