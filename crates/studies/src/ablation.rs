//! Which modification of the firefly algorithm matters: each alone removed from the thesis's cFA, and each
//! alone added to the original algorithm, on the same seeds.

use super::functions::methods::{CASES, Case, clustered, name, original};
use super::functions::outcome::one;
use super::options::Seeds;
use super::quantile::quantile;
use super::row::Row;
use lampyris_core::optimise::thesis_options::CfaThesisOptions;
use lampyris_core::optimise::{Crowd, Edges, Method};
use rayon::prelude::*;
use statrs::distribution::{Binomial, DiscreteCDF};

/// A modification: what it is called, and how a swarm that has it becomes one that does as the other.
struct Modification {
    name: &'static str,
    /// Makes the first argument do as the second in this one respect.
    take: fn(&mut CfaThesisOptions, &CfaThesisOptions),
}

const MODIFICATIONS: [Modification; 8] = [
    Modification {
        name: "normalised distance and growing gamma",
        take: |o, from| (o.gamma_min, o.gamma_max) = (from.gamma_min, from.gamma_max),
    },
    Modification { name: "growing gamma", take: |o, from| (o.gamma_min, o.gamma_max) = gammas(o, from) },
    Modification { name: "alpha decay", take: |o, from| o.decay = from.decay },
    Modification { name: "population control", take: |o, from| o.n_min = from.n_min.min(o.n) },
    Modification { name: "bounce at the edges", take: |o, from| o.edges = from.edges },
    Modification {
        name: "clusters",
        take: |o, from| (o.target, o.target_min) = (from.target, from.target_min),
    },
    Modification {
        name: "shrinking clusters",
        take: |o, from| o.target_min = if from.target_min < from.target { 1.0 } else { o.target },
    },
    Modification { name: "sqrt(n_c)", take: |o, from| o.crowd = from.crowd },
];

/// The other's schedule at this one's scale: constant, or from a small to a large gamma.
fn gammas(o: &CfaThesisOptions, from: &CfaThesisOptions) -> (f64, f64) {
    let scale = o.gamma_max / if o.gamma_min < o.gamma_max { 1.0 } else { from.gamma_max };
    if from.gamma_min < from.gamma_max {
        (from.gamma_min * scale, from.gamma_max * scale)
    } else {
        (1.0, 1.0)
    }
}

/// Medians over the seeds, and how often the change is for the worse.
pub fn run(asked: &Seeds) -> Vec<Row> {
    let (first, seeds) = (asked.first.seed, asked.seeds);
    let mut rows = Vec::new();
    for case in CASES.iter().filter(|case| case.dimensions != 15) {
        let thesis = CfaThesisOptions { crowd: Crowd::Step, ..clustered(case) };
        let plain = CfaThesisOptions {
            crowd: Crowd::Ignored,
            edges: Edges::Clamp,
            ..original(case).as_one_cluster()
        };
        for (base, other, title, word) in
            [(&thesis, &plain, "cFA", "without"), (&plain, &thesis, "original FA", "with")]
        {
            let before = errors(case, base, first, seeds);
            rows.push(Row::new(
                format!("{} {}: {title}, median error", name(case.function), case.dimensions),
                median(&before),
                "",
            ));
            for modification in &MODIFICATIONS {
                let mut changed = base.clone();
                (modification.take)(&mut changed, other);
                if changed == *base {
                    continue;
                }
                let after = errors(case, &changed, first, seeds);
                let (better, worse) = (wins(&after, &before), wins(&before, &after));
                let what = format!(
                    "  {word} {}: {better} better, {worse} worse, p {:.0e}",
                    modification.name,
                    sign_test(better, worse)
                );
                rows.push(Row::new(what, median(&after), ""));
            }
        }
    }
    rows
}

fn errors(case: &Case, options: &CfaThesisOptions, first: u64, seeds: u64) -> Vec<f64> {
    let method = Method::CfaThesis(options.clone());
    (first..first + seeds).into_par_iter().map(|seed| one(case, &method, seed).best).collect()
}

fn median(errors: &[f64]) -> f64 {
    let mut sorted = errors.to_vec();
    sorted.sort_by(f64::total_cmp);
    quantile(&sorted, 0.5)
}

/// On how many seeds the first has the smaller error.
fn wins(one: &[f64], other: &[f64]) -> u64 {
    one.iter().zip(other).filter(|(one, other)| one < other).count() as u64
}

/// The two-sided sign test of pairs: how likely so uneven a count is where the change does nothing.
fn sign_test(better: u64, worse: u64) -> f64 {
    let n = better + worse;
    Binomial::new(0.5, n).map_or(1.0, |coin| (2.0 * coin.cdf(better.min(worse))).min(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sign_test_is_that_of_the_binomial() {
        assert_eq!(sign_test(0, 0), 1.0);
        assert_eq!(sign_test(5, 5), 1.0);
        assert!((sign_test(0, 10) - 2.0 / 1024.0).abs() < 1e-12);
        assert!((sign_test(9, 1) - 22.0 / 1024.0).abs() < 1e-12);
    }

    #[test]
    fn every_modification_changes_one_of_the_two_algorithms() {
        let thesis = CfaThesisOptions { crowd: Crowd::Step, ..clustered(&CASES[0]) };
        let plain = CfaThesisOptions { crowd: Crowd::Ignored, ..original(&CASES[0]).as_one_cluster() };
        for modification in &MODIFICATIONS {
            let mut changed = thesis.clone();
            (modification.take)(&mut changed, &plain);
            assert_ne!(changed, thesis, "{}", modification.name);
        }
    }
}
