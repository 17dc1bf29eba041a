//! What an experiment is about: parameters of the model, and effects that it has or lacks.

use crate::data::Window;
use crate::diagnose::library::{EffectSource, carried};
use crate::estimate::{Problem, Site};
use crate::fault::{Fault, nearest};
use crate::model::Catalogue;

/// A problem whose model has everything that an experiment is about.
#[derive(Debug, Clone)]
pub struct ExperimentSubject {
    /// The problem.
    pub problem: Problem,
    /// Its parameters: those of the fit, and nominal ones of what the fit's model lacks.
    pub theta: Vec<f64>,
    /// The parameters that it is about.
    pub about: Vec<String>,
}

impl ExperimentSubject {
    /// Takes what the model lacks into it. Each name is that of a parameter, or of an effect, which stands
    /// for its parameters.
    ///
    /// # Errors
    /// Every name that is neither, and every effect that these data cannot show.
    pub fn new(
        catalogue: &Catalogue,
        problem: &Problem,
        theta: &[f64],
        window: &Window,
        site: &Site,
        names: &[String],
    ) -> Result<Self, Vec<Fault>> {
        let source = EffectSource::new(catalogue, problem, window, site).map_err(|fault| vec![fault])?;
        let mut found = Self { problem: problem.clone(), theta: theta.to_vec(), about: Vec::new() };
        let mut faults = Vec::new();
        for (at, name) in names.iter().enumerate() {
            if let Err(fault) = found.take(&source, name) {
                faults.push(Fault { pointer: format!("/about/{at}"), ..fault });
            }
        }
        if faults.is_empty() { Ok(found) } else { Err(faults) }
    }

    fn take(&mut self, source: &EffectSource<'_>, name: &str) -> Result<(), Fault> {
        let known = |problem: &Problem, name: &str| {
            problem.model().parameters().iter().any(|parameter| parameter.name == name)
        };
        if known(&self.problem, name) {
            self.about.push(name.to_owned());
            return Ok(());
        }
        let unknown = || {
            let detail = format!("`{name}` is neither a parameter of the model nor an effect");
            let parameters = self.problem.model().parameters().iter().map(|one| one.name.as_str());
            let effects = source.catalogue.effects().map(|effect| effect.id.as_str());
            let fault = Fault::new("/about", "unknown-name", detail);
            match nearest(name, parameters.chain(effects)) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault,
            }
        };
        let effect = source.catalogue.effect(name).map_err(|_| unknown())?;
        if self.problem.model().effects().iter().all(|one| one != name) {
            let candidate = source.candidate(&self.problem, name).map_err(|faults| {
                let details: Vec<String> = faults.into_iter().map(|fault| fault.detail).collect();
                Fault::new("/about", "not-testable", format!("`{name}`: {}", details.join("; ")))
            })?;
            let with = candidate.problem.with_substeps(self.problem.simulator().substeps());
            self.theta = carried(&self.problem, &self.theta, &with);
            self.problem = with;
        }
        let own = effect.parameters.keys().filter(|own| known(&self.problem, own));
        self.about.extend(own.cloned());
        Ok(())
    }
}
