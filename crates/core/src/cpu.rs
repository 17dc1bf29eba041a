//! Instruction sets: work with wide vectors is compiled for several, and runs on the best one of this
//! machine.

/// An instruction set that this machine has. It exists only through [`Cpu::detect`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cpu(Set);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Set {
    /// Whatever the target guarantees.
    Baseline,
    /// AVX2: four doubles at a time.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512F: eight doubles at a time.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Cpu {
    /// The best instruction set of this machine for matrices of so many lanes. One lane fills no vector, and
    /// gathering entries that lie far apart takes longer than what is gained.
    pub fn for_lanes(lanes: usize) -> Self {
        if lanes == 1 { Cpu(Set::Baseline) } else { Self::detect() }
    }

    /// The best instruction set of this machine.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx512f")
                && std::arch::is_x86_feature_detected!("avx512dq")
            {
                return Cpu(Set::Avx512);
            }
            if std::arch::is_x86_feature_detected!("avx2") {
                return Cpu(Set::Avx2);
            }
        }
        Cpu(Set::Baseline)
    }

    /// Its name, for people.
    pub fn name(self) -> &'static str {
        match self.0 {
            Set::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "AVX2",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => "AVX-512",
        }
    }
}

/// Work that gains from wide vectors: its body is compiled once per instruction set, if it and all that it
/// calls is marked `#[inline(always)]`.
pub trait Kernel {
    /// What it computes.
    type Output;
    /// Computes it.
    fn run(self) -> Self::Output;
}

/// Runs a kernel compiled for an instruction set: the only place of the project that needs `unsafe`.
#[inline]
pub fn dispatch<K: Kernel>(cpu: Cpu, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq")]
    fn with_avx512<K: Kernel>(kernel: K) -> K::Output {
        kernel.run()
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn with_avx2<K: Kernel>(kernel: K) -> K::Output {
        kernel.run()
    }

    match cpu.0 {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `Cpu::detect` is the only maker of this value and has found both features.
        #[allow(unsafe_code)]
        Set::Avx512 => unsafe { with_avx512(kernel) },
        #[cfg(target_arch = "x86_64")]
        // SAFETY: `Cpu::detect` is the only maker of this value and has found the feature.
        #[allow(unsafe_code)]
        Set::Avx2 => unsafe { with_avx2(kernel) },
        _ => kernel.run(),
    }
}
