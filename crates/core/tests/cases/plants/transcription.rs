//! A second transcription of the two-tank plant, with the Gujer matrix as numbers and time in days. It shares
//! no code with the program.

/// A generator of numbers that need not be good (Knuth's constants).
pub struct Random(pub u64);

impl Random {
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 11) as f64 / (1u64 << 53) as f64)
    }

    /// A value that the state of this name could have.
    pub fn state(&mut self, name: &str) -> f64 {
        match name {
            "I_O2" => self.between(-0.01, 0.01),
            name if name.starts_with("TSS") => 10f64.powf(self.between(0.0, 4.0)),
            name if name.starts_with('X') => 10f64.powf(self.between(0.0, 3.5)),
            _ => 10f64.powf(self.between(-2.0, 1.7)),
        }
    }
}

/// The sum of some terms, and the sum of their sizes.
#[derive(Clone, Copy, Default)]
struct Sum(f64, f64);

impl Sum {
    fn add(&mut self, term: f64) {
        self.0 += term;
        self.1 += term.abs();
    }
}

/// The equations of plant H per day, the size of what each is made of, and the rates in its aerobic tank.
pub fn plant_h(
    x: &[f64],
    q: f64,
    influent: &[f64],
    free: &dyn Fn(&str) -> Option<f64>,
) -> (Vec<f64>, Vec<f64>, [f64; 8]) {
    let k = |name: &str, fixed: f64| free(name).unwrap_or(fixed);
    let (mu_h, k_s, k_oh, k_no, b_h) = (k("mu_H", 6.0), k("K_S", 20.0), 0.2, 0.5, k("b_H", 0.62));
    let (mu_a, k_nh, k_oa, b_a, eta_g) = (k("mu_A", 0.6), k("K_NH", 1.0), k("K_OA", 0.5), 0.15, 0.8);
    let (k_a, k_h, k_x, eta_h) = (0.08, 3.0, 0.03, 0.4);
    let (y_h, y_a, f_p, i_xb, i_xp) = (k("Y_H", 0.67), 0.24, 0.08, 0.086, 0.06);
    let (anoxic, aerobic, settler, integral) = (&x[..13], &x[13..26], &x[26..106], x[106]);
    let monod = |s: f64, half: f64| s / (half + s);
    let rates = |c: &[f64]| -> [f64; 8] {
        let (s_s, x_s, x_bh, x_ba, s_o, s_no, s_nh, s_nd, x_nd) =
            (c[1], c[3], c[4], c[5], c[7], c[8], c[9], c[10], c[11]);
        let p7 = k_h * (x_s / x_bh) / (k_x + x_s / x_bh)
            * (monod(s_o, k_oh) + eta_h * (1.0 - monod(s_o, k_oh)) * monod(s_no, k_no))
            * x_bh;
        [
            mu_h * monod(s_s, k_s) * monod(s_o, k_oh) * x_bh,
            mu_h * monod(s_s, k_s) * k_oh / (k_oh + s_o) * monod(s_no, k_no) * eta_g * x_bh,
            mu_a * monod(s_nh, k_nh) * monod(s_o, k_oa) * x_ba,
            b_h * x_bh,
            b_a * x_ba,
            k_a * s_nd * x_bh,
            p7,
            p7 * x_nd / x_s,
        ]
    };
    // Rows are processes, columns S_I S_S X_I X_S X_BH X_BA X_P S_O S_NO S_NH S_ND X_ND S_ALK.
    let n = i_xb - f_p * i_xp;
    #[rustfmt::skip]
    let gujer: [[f64; 13]; 8] = [
        [0.0, -1.0 / y_h, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0 - 1.0 / y_h, 0.0, -i_xb, 0.0, 0.0, -i_xb / 14.0],
        [
            0.0,
            -1.0 / y_h,
            0.0,
            0.0,
            1.0,
            0.0,
            0.0,
            0.0,
            (1.0 - 1.0 / y_h) / 2.86,
            -i_xb,
            0.0,
            0.0,
            ((1.0 / y_h - 1.0) / 2.86 - i_xb) / 14.0
        ],
        [
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            1.0,
            0.0,
            1.0 - 4.57 / y_a,
            1.0 / y_a,
            -i_xb - 1.0 / y_a,
            0.0,
            0.0,
            -(i_xb + 2.0 / y_a) / 14.0
        ],
        [0.0, 0.0, 0.0, 1.0 - f_p, -1.0, 0.0, f_p, 0.0, 0.0, 0.0, 0.0, n, 0.0],
        [0.0, 0.0, 0.0, 1.0 - f_p, 0.0, -1.0, f_p, 0.0, 0.0, 0.0, 0.0, n, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 1.0 / 14.0],
        [0.0, 1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0],
    ];
    let is_solid = |component: usize| [2, 3, 4, 5, 6, 11].contains(&component);
    let dissolved: Vec<usize> = (0..13).filter(|component| !is_solid(*component)).collect();
    let tss = |c: &[f64]| 0.75 * (c[2] + c[3] + c[4] + c[5] + c[6]);
    let layer = |block: usize, i: usize| settler[10 * block + i];
    let (q_a, q_w, q_u) = (55_440.0, 385.0, 20_160.0);
    let (q_r, q_f, q_e) = (q_u - q_w, q + q_u - q_w, q - q_w);
    let feed = tss(aerobic);
    let mut sums = vec![Sum::default(); 107];
    let error = 1.5 - aerobic[7];
    let wanted = 120.0 + 25.0 * (error + integral / 0.002);
    let k_l_a = wanted.clamp(0.0, 360.0);
    for (tank, (here, volume)) in [(anoxic, 2000.0), (aerobic, 6000.0)].into_iter().enumerate() {
        let rate = rates(here);
        for c in 0..13 {
            let sum = &mut sums[13 * tank + c];
            if tank == 0 {
                let returned = match dissolved.iter().position(|known| *known == c) {
                    Some(block) => layer(block, 9),
                    None => aerobic[c] * layer(7, 9) / feed,
                };
                sum.add(q * influent[c] / volume);
                sum.add(q_a * aerobic[c] / volume);
                sum.add(q_r * returned / volume);
            } else {
                sum.add((q + q_a + q_r) * anoxic[c] / volume);
            }
            sum.add(-(q + q_a + q_r) * here[c] / volume);
            (0..8).for_each(|j| sum.add(gujer[j][c] * rate[j]));
        }
    }
    sums[13 + 7].add(k_l_a * 8.0);
    sums[13 + 7].add(-k_l_a * aerobic[7]);
    // The settler: 1500 m2, ten layers of 0.4 m, fed into the fifth.
    let (up, down, height) = (q_e / 1500.0, q_u / 1500.0, 0.4);
    let velocity = |solids: f64| {
        let above = solids - 0.00228 * feed;
        (474.0 * ((-0.000576 * above).exp() - (-0.00286 * above).exp())).clamp(0.0, 250.0)
    };
    let flux: Vec<f64> = (0..10).map(|i| velocity(layer(7, i)) * layer(7, i)).collect();
    let sinking =
        |i: usize| if i < 4 && layer(7, i + 1) <= 3000.0 { flux[i] } else { flux[i].min(flux[i + 1]) };
    for block in 0..8 {
        let entering = if block == 7 { feed } else { aerobic[dissolved[block]] };
        for i in 0..10 {
            let sum = &mut sums[26 + 10 * block + i];
            let here = layer(block, i);
            match i {
                0..4 => {
                    [up * layer(block, i + 1), -up * here].into_iter().for_each(|term| sum.add(term / height))
                }
                4 => [q_f / 1500.0 * entering, -(up + down) * here]
                    .into_iter()
                    .for_each(|term| sum.add(term / height)),
                _ => [down * layer(block, i - 1), -down * here]
                    .into_iter()
                    .for_each(|term| sum.add(term / height)),
            }
            if block == 7 && i > 0 {
                sum.add(sinking(i - 1) / height);
            }
            if block == 7 && i < 9 {
                sum.add(-sinking(i) / height);
            }
        }
    }
    sums[106].add(error);
    sums[106].add(2.0 * (k_l_a - wanted) / 25.0);
    (sums.iter().map(|sum| sum.0).collect(), sums.iter().map(|sum| sum.1).collect(), rates(aerobic))
}
