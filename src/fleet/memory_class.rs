//! What a job needs of a worker beside its program.

/// What a job needs of a worker: memory, in classes. A subject names the class, and a worker subscribes to those that
/// it has the memory for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct MemoryClass {
    gigabytes: u32,
}

impl MemoryClass {
    /// In gigabytes; the last one is the largest that a configuration may ask for.
    const CLASSES: [u32; 5] = [4, 16, 64, 256, 1024];
    /// Memory of the smallest class, in megabytes: a worker that gives a job less can do none.
    pub const LEAST_MB: u32 = Self::CLASSES[0] * 1000;

    /// The class of a job that may take this much memory.
    pub fn of(memory_mb: u32) -> Self {
        let most = Self::CLASSES[Self::CLASSES.len() - 1];
        let fits = |class: &&u32| memory_mb <= **class * 1000;
        let gigabytes = Self::CLASSES.iter().find(fits).copied().unwrap_or(most);
        Self { gigabytes }
    }

    /// The classes of jobs that a worker can do which gives each this much memory.
    pub fn within(memory_mb: u32) -> Vec<Self> {
        let classes = Self::CLASSES
            .into_iter()
            .map(|gigabytes| Self { gigabytes });
        classes
            .filter(|class| class.memory_mb() <= memory_mb)
            .collect()
    }

    /// Whether a worker that gives each job this much memory does jobs of the class that a subject names.
    pub(super) fn fits(token: &str, memory_mb: u32) -> bool {
        let classes = Self::within(memory_mb);
        classes.into_iter().any(|class| class.token() == token)
    }

    const fn memory_mb(self) -> u32 {
        self.gigabytes * 1000
    }

    pub(super) fn token(self) -> String {
        format!("m{}", self.gigabytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_goes_to_workers_with_its_memory() {
        assert_eq!(MemoryClass::of(64), MemoryClass::of(4000));
        assert_eq!(MemoryClass::of(4001), MemoryClass::of(16_000));
        assert_eq!(MemoryClass::of(1_000_000).token(), "m1024");
        let tokens = |mb| {
            MemoryClass::within(mb)
                .into_iter()
                .map(MemoryClass::token)
                .collect::<Vec<_>>()
        };
        assert!(tokens(3999).is_empty());
        assert_eq!(tokens(4000), ["m4"]);
        assert_eq!(tokens(63_999), ["m4", "m16"]);
        assert_eq!(tokens(64_000), ["m4", "m16", "m64"]);
        assert!(MemoryClass::fits("m16", 16_000) && !MemoryClass::fits("m16", 15_999));
    }
}
