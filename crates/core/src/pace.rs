//! How long work in stages will still take, from what a unit of each stage has taken so far.
//!
//! The core has no clock: seconds come from its caller.

/// A stretch of a diagnosis, or of a ladder, whose units take about equally long.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WorkStage {
    /// The fit of the model as it is.
    #[default]
    Fit,
    /// The null model comes to its optima.
    Settle,
    /// Every effect is scored, and heard in segments of hours.
    Screen,
    /// An effect is searched from the nominal values.
    Restart,
    /// An effect goes the first part of its way.
    Begin,
    /// An effect goes the rest of it.
    Refit,
    /// The null model goes on from where one of the best has come to, before the gates decide.
    Judge,
    /// What was found is taken in, asked for the way of its heat, and described.
    Name,
}

const STAGES: usize = 8;
/// What a unit of each stage usually takes beside the others: all that is known of a stage before its first
/// unit has been seen.
const USUAL: [f64; STAGES] = [3.0, 1.0, 0.9, 0.2, 0.14, 0.17, 0.3, 1.1];
/// So many units of a stage count for as much as what is usual.
const DOUBT: f64 = 1.0;
/// A unit that takes longer than was expected goes on for this share of what it has taken.
const OVERDUE: f64 = 0.3;

/// Units of work by stage: those that are done, and those that are expected.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plan {
    stage: WorkStage,
    done: [f64; STAGES],
    left: [f64; STAGES],
}

impl Plan {
    /// So many units are expected of a stage.
    pub fn expect(&mut self, stage: WorkStage, units: f64) {
        self.left[stage as usize] = units;
    }

    /// A stage of so many units begins; the one before is over.
    pub fn enter(&mut self, stage: WorkStage, units: f64) {
        let over = self.stage as usize;
        // The last stretch of a stage has no event of its own.
        self.done[over] += self.left[over];
        self.left[over] = 0.0;
        self.stage = stage;
        self.expect(stage, units);
    }

    /// Where the work is.
    pub fn stage(&self) -> WorkStage {
        self.stage
    }

    /// A unit of the present stage is done.
    pub fn step(&mut self) {
        let now = self.stage as usize;
        self.done[now] += 1.0;
        self.left[now] = (self.left[now] - 1.0).max(0.0);
    }

    /// The same with further units behind those that are left.
    #[must_use]
    pub fn and(&self, further: &[(WorkStage, f64)]) -> Self {
        let mut more = self.clone();
        further.iter().for_each(|(stage, units)| more.left[*stage as usize] += units);
        more
    }
}

/// The clock beside a plan.
#[derive(Debug, Clone, Default)]
pub struct Pace {
    plan: Plan,
    /// What the units that are done have taken, by stage.
    seconds: [f64; STAGES],
    /// When the last of them was done.
    since: f64,
}

impl Pace {
    /// Notes what is done and what is left after so many seconds.
    pub fn note(&mut self, now: f64, plan: &Plan) {
        if (plan.stage, plan.done) != (self.plan.stage, self.plan.done) {
            self.seconds[self.plan.stage as usize] += now - self.since;
            self.since = now;
        }
        self.plan = plan.clone();
    }

    /// The seconds that are left; `None` until something was measured.
    pub fn left(&self, now: f64) -> Option<f64> {
        let Plan { done, left, .. } = &self.plan;
        let since = |first: usize| {
            let usual: f64 = (first..STAGES).map(|stage| done[stage] * USUAL[stage]).sum();
            (usual > 0.0).then(|| self.seconds[first..].iter().sum::<f64>() / usual)
        };
        // A fit takes what its search takes: it tells least of what comes behind it.
        let unit = since(WorkStage::Settle as usize).or_else(|| since(WorkStage::Fit as usize))?;
        let cost = |stage: usize| (self.seconds[stage] + DOUBT * USUAL[stage] * unit) / (done[stage] + DOUBT);
        let expected: f64 = (0..STAGES).map(|stage| left[stage] * cost(stage)).sum();
        let running = now - self.since;
        Some((expected - running).max(OVERDUE * running))
    }

    /// The share of all the time that has passed.
    pub fn share(&self, now: f64) -> Option<f64> {
        self.left(now).map(|left| now / (now + left).max(f64::MIN_POSITIVE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plan that has come to the refits of a round, after so many seconds for the fit and for each stage.
    fn refitting(pace: &mut Pace, seconds: f64) -> Plan {
        let mut plan = Plan::default();
        plan.expect(WorkStage::Fit, 1.0);
        let stages = [
            (WorkStage::Settle, 1.0),
            (WorkStage::Screen, 1.0),
            (WorkStage::Begin, 10.0),
            (WorkStage::Refit, 10.0),
        ];
        for (number, (stage, units)) in stages.into_iter().enumerate() {
            plan.enter(stage, units);
            pace.note(seconds * (number + 1) as f64, &plan);
        }
        plan
    }

    #[test]
    fn nothing_is_said_before_something_was_measured() {
        let mut pace = Pace::default();
        assert_eq!((pace.left(5.0), pace.share(5.0)), (None, None));
        let mut plan = Plan::default();
        plan.expect(WorkStage::Fit, 1.0);
        plan.enter(WorkStage::Settle, 1.0);
        pace.note(10.0, &plan);
        let left = pace.left(10.0).unwrap();
        assert!(
            (left - 10.0 * USUAL[WorkStage::Settle as usize] / USUAL[WorkStage::Fit as usize]).abs() < 1e-9,
            "{left}"
        );
        assert!((pace.share(10.0).unwrap() - 10.0 / (10.0 + left)).abs() < 1e-9);
    }

    #[test]
    fn what_a_stage_takes_is_learnt_from_its_own_units() {
        let mut pace = Pace::default();
        let mut plan = refitting(&mut pace, 10.0);
        // Each refit takes three seconds, whatever is usual: seven are left.
        for done in 1..=3 {
            plan.step();
            pace.note(40.0 + 3.0 * f64::from(done), &plan);
        }
        let left = pace.left(49.0).unwrap();
        assert!((14.0..28.0).contains(&left), "{left}");
        // Between two of them it goes down with the clock.
        assert!((pace.left(50.0).unwrap() - (left - 1.0)).abs() < 1e-9);
        // A later stage takes what the stages that were seen say of the machine.
        let judging = pace.left(49.0).map(|before| {
            pace.note(49.0, &plan.and(&[(WorkStage::Judge, 1.0)]));
            pace.left(49.0).unwrap() - before
        });
        assert!(judging.is_some_and(|more| more > 1.0), "{judging:?}");
    }

    #[test]
    fn what_takes_longer_than_expected_is_never_about_to_end() {
        let mut pace = Pace::default();
        let mut plan = refitting(&mut pace, 1.0);
        plan.enter(WorkStage::Judge, 1.0);
        pace.note(5.0, &plan);
        for running in [50.0, 100.0, 200.0] {
            assert!((pace.left(5.0 + running).unwrap() - OVERDUE * running).abs() < 1e-9);
        }
    }

    #[test]
    fn a_stage_that_is_over_leaves_nothing_to_do() {
        let mut plan = Plan::default();
        plan.enter(WorkStage::Begin, 5.0);
        plan.step();
        plan.enter(WorkStage::Refit, 2.0);
        assert_eq!((plan.done[WorkStage::Begin as usize], plan.left[WorkStage::Begin as usize]), (5.0, 0.0));
        let further = plan.and(&[(WorkStage::Refit, 3.0), (WorkStage::Judge, 1.0)]);
        assert_eq!(
            (further.left[WorkStage::Refit as usize], further.left[WorkStage::Judge as usize]),
            (5.0, 1.0)
        );
    }
}
