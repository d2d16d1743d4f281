//! Statistics of runs: medians with quartiles, as Markdown, CSV and JSON.

use super::plan::Group;
use super::run::Run;
use crate::error::{Error, Result};
use crate::search::cem::Objective;
use serde::Serialize;

/// Minimum, quartiles and maximum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// Minimum.
    pub min: f64,
    /// Lower quartile.
    pub lower: f64,
    /// Median.
    pub median: f64,
    /// Upper quartile.
    pub upper: f64,
    /// Maximum.
    pub max: f64,
}

impl Spread {
    /// Statistics of values in any order, interpolated between neighbours; `None` without values.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Spread> {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let at = |part: f64| {
            let place = part * last as f64;
            let (below, above) = (values[place.floor() as usize], values[place.ceil() as usize]);
            // Infinite neighbours have no difference.
            if below == above { below } else { below + (place - place.floor()) * (above - below) }
        };
        Some(Spread { min: values[0], lower: at(0.25), median: at(0.5), upper: at(0.75), max: values[last] })
    }
}

/// Formats the median with quartiles, with three digits.
impl std::fmt::Display for Spread {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{} ({}, {})", digits(self.median), digits(self.lower), digits(self.upper))
    }
}

/// A number with three significant digits.
fn digits(x: f64) -> String {
    if x == 0. || !x.is_finite() {
        return format!("{x}");
    }
    let decimals = (2. - x.abs().log10().floor()).max(0.) as usize;
    if decimals > 5 { format!("{x:.1e}") } else { format!("{x:.decimals$}") }
}

/// Runs of one line of a table.
#[derive(Debug, Clone)]
pub struct Line<'a> {
    /// Common properties of the runs.
    pub group: Group,
    /// Runs, in the order in which they were made.
    pub runs: Vec<&'a Run>,
}

/// Runs by group, in the order of the paper's tables: by scenario, objective, population, then method.
pub fn lines(runs: &[Run]) -> Vec<Line<'_>> {
    let mut lines: Vec<Line> = Vec::new();
    for run in runs {
        let group = run.case.group();
        match lines.iter_mut().find(|line| line.group == group) {
            Some(line) => line.runs.push(run),
            None => lines.push(Line { group, runs: vec![run] }),
        }
    }
    let place = |line: &Line| {
        let group = &line.group;
        let scenario = ["biped", "s1", "s2", "s3", "hex"].iter().position(|s| *s == group.scenario);
        (scenario, group.objective == Objective::LeastForce, group.generations, group.population, group.method as usize, !group.heuristic)
    };
    lines.sort_by_key(place);
    lines
}

/// Statistics of a line.
#[derive(Debug, Clone, Serialize)]
pub struct LineSummary {
    scenario: String,
    method: &'static str,
    about: &'static str,
    heuristic: bool,
    objective: Objective,
    population: usize,
    generations: usize,
    runs: usize,
    found: usize,
    /// Time to the first feasible motion, s. Runs without one count with their whole time.
    first_feasible_seconds: Option<Spread>,
    /// Time of the whole run, s.
    seconds: Option<Spread>,
    candidates: Option<Spread>,
    /// Number of rows of the result that `verify` finds violated.
    n_violated: Option<Spread>,
    /// Largest position error of the body under the planned forces, m.
    rollout_position: Option<Spread>,
    /// Largest distance of a foot outside its box at any time, m.
    reach_excess: Option<Spread>,
    /// Best objective as a cost, over the runs that found a gait: stance phases, or mean normal force in N.
    reached: Option<Spread>,
    budget: String,
}

impl Line<'_> {
    /// Statistics of the runs.
    pub fn summary(&self) -> LineSummary {
        let spread = |value: &dyn Fn(&Run) -> Option<f64>| Spread::of(self.runs.iter().filter_map(|run| value(run)));
        LineSummary {
            scenario: self.group.scenario.clone(),
            method: self.group.method.name(),
            about: self.group.method.about(),
            heuristic: self.group.heuristic,
            objective: self.group.objective,
            population: self.group.population,
            generations: self.group.generations,
            runs: self.runs.len(),
            found: self.runs.iter().filter(|run| run.success).count(),
            first_feasible_seconds: spread(&|run| Some(run.first_or_all())),
            seconds: spread(&|run| Some(run.seconds)),
            candidates: spread(&|run| Some(run.candidates as f64)),
            n_violated: spread(&|run| run.n_violated.map(|n| n as f64)),
            rollout_position: spread(&|run| run.rollout_position),
            reach_excess: spread(&|run| run.reach_excess),
            reached: spread(&|run| run.cost()),
            budget: self.runs[0].budget.clone(),
        }
    }
}

/// Markdown table of an experiment.
pub fn markdown(experiment: u8, runs: &[Run]) -> String {
    let lines = lines(runs);
    let mut text = String::new();
    let cell = |spread: Option<Spread>| spread.map_or("-".into(), |s| s.to_string());
    let middle = |spread: Option<Spread>| spread.map_or("-".into(), |s| digits(s.median));
    let count = |spread: Option<Spread>| spread.map_or("-".into(), |s| format!("{:.0}", s.median));
    if experiment < 3 {
        let (what, rule) = if experiment == 1 { ("method", "") } else { ("method | heuristic", "---|") };
        text += &format!(
            "| scenario | {what} | found | first feasible motion, s | whole run, s | candidates | rows violated | body off its plan, m | foot out of reach, m |\n"
        );
        text += &format!("|---|---|{rule}---|---|---|---|---|---|---|\n");
        for line in &lines {
            let s = line.summary();
            let heuristic = if experiment == 1 { String::new() } else { format!(" | {}", with(s.heuristic)) };
            text += &format!(
                "| {} | {}{heuristic} | {} of {} | {} | {} | {} | {} | {} | {} |\n",
                s.scenario,
                s.about,
                s.found,
                s.runs,
                cell(s.first_feasible_seconds),
                cell(s.seconds),
                count(s.candidates),
                count(s.n_violated),
                middle(s.rollout_position),
                middle(s.reach_excess),
            );
        }
    } else {
        text += "| objective | population | generations | heuristic | found | reached | whole run, s | candidates |\n|---|---|---|---|---|---|---|---|\n";
        for line in &lines {
            let s = line.summary();
            text += &format!(
                "| {} | {} | {} | {} | {} of {} | {} | {} | {} |\n",
                title(s.objective),
                s.population,
                s.generations,
                with(s.heuristic),
                s.found,
                s.runs,
                cell(s.reached),
                cell(s.seconds),
                count(s.candidates),
            );
        }
    }
    text + "\nMedian (quartiles). Times include failing candidates; a run that found nothing counts with all its time.\n"
}

/// The word "with" or "without", for the heuristic.
pub fn with(heuristic: bool) -> &'static str {
    if heuristic { "with" } else { "without" }
}

/// Objective in words, with the unit of its cost.
pub fn title(objective: Objective) -> &'static str {
    match objective {
        Objective::Feasibility => "feasibility",
        Objective::FewestStances => "fewest stance phases",
        Objective::LeastForce => "least mean normal force, N",
        Objective::Transport => "cost of transport",
        Objective::Time => "time, s",
        Objective::Effort => "effort",
    }
}

/// Statistics of all lines as JSON, with version, machine, threads and seeds.
///
/// # Errors
/// [`Error::Format`] if a number has no JSON representation.
pub fn json(experiment: u8, runs: &[Run]) -> Result<String> {
    #[derive(Serialize)]
    struct Summary<'a> {
        experiment: u8,
        version: &'a str,
        machine: &'a str,
        threads: usize,
        seeds: Vec<u64>,
        lines: Vec<LineSummary>,
    }
    let mut seeds: Vec<u64> = runs.iter().map(|run| run.case.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    let first = runs.first();
    let summary = Summary {
        experiment,
        version: first.map_or("", |run| &run.version),
        machine: first.map_or("", |run| &run.machine),
        threads: runs.iter().map(|run| run.threads).max().unwrap_or(0),
        seeds,
        lines: lines(runs).iter().map(Line::summary).collect(),
    };
    Ok(serde_json::to_string_pretty(&summary)? + "\n")
}

/// CSV table with one row per run.
///
/// # Errors
/// [`Error::Format`] if a row cannot be written.
pub fn csv(runs: &[Run]) -> Result<String> {
    let failed = |e: &dyn std::fmt::Display| Error::Format { message: e.to_string() };
    let mut writer = csv::Writer::from_writer(Vec::new());
    let header = "experiment scenario target replicate seed method heuristic objective population generations success first_feasible_seconds seconds \
                  generations_run candidates n_violated max_violation rollout_position rollout_attitude reach_excess mean_normal_force stances \
                  cost threads device machine version budget unix_time";
    writer.write_record(header.split_whitespace()).map_err(|e| failed(&e))?;
    let text = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
    for run in runs {
        let case = &run.case;
        let objective = serde_json::to_value(case.objective)?;
        let record = [
            case.experiment.to_string(),
            case.scenario.clone(),
            case.target.map(|t| t.to_string()).unwrap_or_default(),
            case.replicate.to_string(),
            case.seed.to_string(),
            case.method.to_string(),
            case.heuristic.to_string(),
            objective.as_str().unwrap_or_default().into(),
            case.population.to_string(),
            case.generations.to_string(),
            run.success.to_string(),
            text(run.first_feasible_seconds),
            run.seconds.to_string(),
            run.generations_run.to_string(),
            run.candidates.to_string(),
            run.n_violated.map(|n| n.to_string()).unwrap_or_default(),
            text(run.max_violation),
            text(run.rollout_position),
            text(run.rollout_attitude),
            text(run.reach_excess),
            text(run.mean_normal_force),
            run.stances().to_string(),
            text(run.cost()),
            run.threads.to_string(),
            run.device.clone(),
            run.machine.clone(),
            run.version.clone(),
            run.budget.clone(),
            run.unix_time.to_string(),
        ];
        writer.write_record(&record).map_err(|e| failed(&e))?;
    }
    let bytes = writer.into_inner().map_err(|e| failed(&e))?;
    String::from_utf8(bytes).map_err(|e| failed(&e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_lie_between_neighbours() {
        let spread = Spread::of([4., 1., 3., 2., 5.]).unwrap();
        assert_eq!((spread.min, spread.lower, spread.median, spread.upper, spread.max), (1., 2., 3., 4., 5.));
        let spread = Spread::of([1., 2.]).unwrap();
        assert_eq!((spread.lower, spread.median, spread.upper), (1.25, 1.5, 1.75));
        assert_eq!(Spread::of([]), None);
        assert_eq!(Spread::of([f64::INFINITY, f64::INFINITY]).unwrap().median, f64::INFINITY);
    }

    #[test]
    fn numbers_have_three_digits() {
        assert_eq!([0.062_34, 1.234, 41.37, 4096., 0., 1e-7].map(digits), ["0.0623", "1.23", "41.4", "4096", "0", "1.0e-7"]);
    }
}
