//! How training goes, live on the terminal: the loss over all steps, and the errors on held-out
//! frames.

use super::ui;
use indicatif::ProgressBar;
use lsdc_eval::metrics::Metric;
use lsdc_train::training::TrainingEvent;

/// Characters of a curve.
const WIDTH: usize = 50;

pub(super) struct Dashboard {
    bar: ProgressBar,
    steps: usize,
    /// The sum of losses, and their number, in equal parts of the run.
    losses: [(f64, usize); WIDTH],
    errors: Vec<f64>,
}

impl Dashboard {
    /// Creates the dashboard of a run with this number of steps.
    pub(super) fn new(steps: usize) -> Self {
        Self {
            bar: ui::bar(steps, "steps"),
            steps,
            losses: [(0.0, 0); WIDTH],
            errors: Vec::new(),
        }
    }

    pub(super) fn show(&mut self, event: &TrainingEvent) {
        match event {
            TrainingEvent::Step {
                step,
                loss,
                rmse,
                seconds,
                ..
            } => {
                let part = (step - 1) * WIDTH / self.steps.max(1);
                let (sum, count) = &mut self.losses[part.min(WIDTH - 1)];
                *sum += loss;
                *count += 1;
                self.bar.set_position(*step as u64);
                self.bar.set_message(format!(
                    "loss {loss:.4}, rmse {rmse:.3} m, {seconds:.2} s a step{}",
                    self.curves()
                ));
            }
            TrainingEvent::Measured { step, held_out } => {
                let (rmse, rel) = (held_out[Metric::Rmse], held_out[Metric::Rel]);
                self.errors.push(rmse);
                self.bar.suspend(|| {
                    ui::say(&format!(
                        "step {step}: held-out frames RMSE {rmse:.4} m, REL {rel:.4}"
                    ));
                });
            }
        }
    }

    pub(super) fn finish(self) {
        self.bar.finish_and_clear();
    }

    fn curves(&self) -> String {
        let seen = self.losses.iter().filter(|(_, count)| *count > 0);
        let losses: Vec<f64> = seen.map(|(sum, count)| sum / *count as f64).collect();
        let named = [("loss", &losses), ("held out", &self.errors)];
        let curves = named.into_iter().filter(|(_, values)| values.len() > 1);
        curves.fold(String::new(), |text, (name, values)| {
            let last = &values[values.len().saturating_sub(WIDTH)..];
            text + &format!("\n{name:>8} {}", curve(last))
        })
    }
}

/// Values as bars from the least to the largest, both written beside them.
fn curve(values: &[f64]) -> String {
    const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let height = |v: f64| (v - low) / (high - low).max(f64::MIN_POSITIVE) * 7.0;
    let bars = values.iter().map(|&v| BARS[height(v).round() as usize % 8]);
    format!("{} {low:.4} to {high:.4}", bars.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_falls_from_the_largest_value_to_the_least() {
        assert_eq!(curve(&[4.0, 2.0, 1.0, 0.5]), "█▄▂▁ 0.5000 to 4.0000");
        assert_eq!(curve(&[1.0, 1.0]), "▁▁ 1.0000 to 1.0000");
    }
}
