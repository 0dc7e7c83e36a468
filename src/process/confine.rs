//! Confines a process that reads other people's bytes: it may compute, read the files that it is given and write into
//! its output folder. It has no network, starts no process, sends no signal, and has a memory limit. Landlock guards
//! the files and a seccomp filter the system calls; if a kernel lacks one of them, this is logged. design/workers.md
//! has the reasons.

use super::priority::lower_priority;
use super::system::close_inherited;
use landlock::{
    ABI, Access, AccessFs, AccessNet, Ruleset, RulesetAttr, RulesetCreatedAttr, RulesetError,
    RulesetStatus, Scope, path_beneath_rules,
};
use rustix::process::{Pid, Resource, Rlimit, Signal};
use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter,
    SeccompRule,
};
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// How much a process may have of what it shares with others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Memory in megabytes; also the largest file it may write.
    pub memory_mb: u32,
    /// Its nice value, 0 to 19.
    pub nice: u32,
}

/// Why a process cannot be confined.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum ConfineError {
    /// The process that started it has ended.
    #[error("the process that started this one has ended")]
    Orphan,
    /// A limit cannot be set.
    #[error("cannot set {what}: {cause}")]
    Limit {
        what: &'static str,
        cause: std::io::Error,
    },
    /// The filter of system calls is refused.
    #[error("cannot make a filter of system calls: {0}")]
    Calls(#[from] seccompiler::BackendError),
}

/// Makes this process end with its parent, which has the id `parent`, and closes all files that it inherited but the
/// standard ones. To be called before anything is opened.
///
/// # Errors
/// If that process has ended already, or the system refuses.
pub fn bind_to_parent(parent: u32) -> Result<(), ConfineError> {
    let refused = |cause: rustix::io::Errno| limit_error("its end with its parent", cause.into());
    rustix::process::set_parent_process_death_signal(Some(Signal::KILL)).map_err(refused)?;
    // It may have died before it could be bound to.
    if rustix::process::getppid()
        .map(Pid::as_raw_nonzero)
        .map(|p| p.get() as u32)
        != Some(parent)
    {
        return Err(ConfineError::Orphan);
    }
    close_inherited().map_err(|cause| limit_error("its open files", cause))
}

/// Confines this thread and all threads that it starts, and limits the whole process, for ever. It may read what is in
/// `reads` and read and write what is in `writes`. Returns messages about what this system cannot do.
///
/// # Errors
/// If a limit cannot be set.
pub fn confine(
    limits: Limits,
    reads: &[PathBuf],
    writes: &[PathBuf],
) -> Result<Vec<String>, ConfineError> {
    let missing = lower_priority(limits.nice).into_iter();
    let mut missing: Vec<String> = missing
        .map(|what| format!("for a confined process, this system cannot set {what}"))
        .collect();
    let bytes = u64::from(limits.memory_mb) * 1_000_000;
    set_limit("the limit of memory", Resource::Data, bytes)?;
    set_limit("the largest file", Resource::Fsize, bytes)?;
    set_limit("the size of core dumps", Resource::Core, 0)?;
    let unguarded = match guard_files(reads, writes) {
        Ok(true) => None,
        Ok(false) => Some("the kernel does not have it".to_owned()),
        Err(error) => Some(error.to_string()),
    };
    missing.extend(unguarded.map(|why| {
        format!(
            "Landlock cannot be used ({why}): a confined process could read and write other files than \
            its own"
        )
    }));
    for filter in [unknown_calls()?, denied_calls()?] {
        if let Err(error) = seccompiler::apply_filter(&filter) {
            missing.push(format!(
                "system calls cannot be filtered ({error}): a confined process could use the network and \
                send signals"
            ));
        }
    }
    Ok(missing)
}

fn limit_error(what: &'static str, cause: std::io::Error) -> ConfineError {
    ConfineError::Limit { what, cause }
}

fn set_limit(what: &'static str, resource: Resource, most: u64) -> Result<(), ConfineError> {
    let bounded = Rlimit {
        current: Some(most),
        maximum: Some(most),
    };
    rustix::process::setrlimit(resource, bounded).map_err(|cause| limit_error(what, cause.into()))
}

/// What a process reads of the system itself: its own state, how many processors there are, the machine's name.
const SYSTEM: [&str; 4] = [
    "/proc/self",
    "/proc/sys/kernel",
    "/sys/fs/cgroup",
    "/sys/devices/system/cpu",
];

/// Forbids all files but these; false where the kernel has no Landlock.
fn guard_files(reads: &[PathBuf], writes: &[PathBuf]) -> Result<bool, RulesetError> {
    // What the newest kernel knows; older ones take what they know of it, and the filter of calls has the rest.
    let abi = ABI::V6;
    let read = AccessFs::ReadFile | AccessFs::ReadDir;
    let write = read
        | AccessFs::WriteFile
        | AccessFs::Truncate
        | AccessFs::MakeReg
        | AccessFs::MakeDir
        | AccessFs::RemoveFile
        | AccessFs::RemoveDir;
    let reads = reads.iter().map(PathBuf::as_path);
    let status = Ruleset::default()
        .handle_access(AccessFs::from_all(abi))?
        .handle_access(AccessNet::from_all(abi))?
        .scope(Scope::from_all(abi))?
        .create()?
        .add_rules(path_beneath_rules(reads.chain(SYSTEM.map(Path::new)), read))?
        .add_rules(path_beneath_rules(writes, write))?
        .restrict_self()?;
    Ok(status.ruleset != RulesetStatus::NotEnforced)
}

/// The call that starts threads and processes hides its flags from a filter; without it, libraries use the older one.
fn unknown_calls() -> Result<BpfProgram, seccompiler::BackendError> {
    program([(libc::SYS_clone3, vec![])].into(), libc::ENOSYS)
}

/// Network, processes, signals, and whatever changes a file and Landlock does not guard.
fn denied_calls() -> Result<BpfProgram, seccompiler::BackendError> {
    let mut rules: BTreeMap<i64, Vec<SeccompRule>> = BTreeMap::new();
    rules.extend(DENIED.iter().map(|call| (*call, vec![])));
    let own = u64::from(std::process::id());
    let others = || condition(0, SeccompCmpOp::Ne, own);
    // A process may end itself, and ask for its own limits.
    rules.insert(libc::SYS_tgkill, vec![SeccompRule::new(vec![others()?])?]);
    let not_itself = vec![others()?, condition(0, SeccompCmpOp::Ne, 0)?];
    rules.insert(libc::SYS_prlimit64, vec![SeccompRule::new(not_itself)?]);
    let thread = libc::CLONE_THREAD as u64;
    let no_thread = condition(0, SeccompCmpOp::MaskedEq(thread), 0)?;
    rules.insert(libc::SYS_clone, vec![SeccompRule::new(vec![no_thread])?]);
    // To open for reading, or for nothing, and to cut off: older versions of Landlock do not see it.
    let cutting = |way: i32| {
        let mask = (libc::O_TRUNC | libc::O_ACCMODE) as u64;
        let flags = (libc::O_TRUNC | way) as u64;
        move |argument| condition(argument, SeccompCmpOp::MaskedEq(mask), flags)
    };
    let (read, nothing) = (cutting(libc::O_RDONLY), cutting(libc::O_ACCMODE));
    for (call, argument) in OPEN {
        let refused = [
            SeccompRule::new(vec![read(*argument)?])?,
            SeccompRule::new(vec![nothing(*argument)?])?,
        ];
        rules.insert(*call, refused.into());
    }
    for (call, commands) in SIGNALLING {
        let refused = commands.iter().map(|c| one_command(*c));
        rules.insert(*call, refused.collect::<Result<_, _>>()?);
    }
    if cfg!(target_arch = "x86_64") {
        rules.extend(X32_ALONE.map(|call| (call, vec![])));
    }
    program(rules, libc::EPERM)
}

/// What the numbers of the x32 ABI begin with: nearly all calls have the same ones there, with this bit.
const X32: i64 = 0x4000_0000;

/// Calls that have a number of their own in it, `execve` and `ioctl` among them.
const X32_ALONE: RangeInclusive<i64> = (X32 | 512)..=(X32 | 547);

/// The rule for a command, which is the second argument; the kernel looks at 32 bits of it.
fn one_command(command: u64) -> Result<SeccompRule, seccompiler::BackendError> {
    SeccompRule::new(vec![condition(1, SeccompCmpOp::Eq, command)?])
}

/// Calls that are needed, and commands of theirs by which an open file sends signals to whichever process one names.
const SIGNALLING: &[(i64, &[u64])] = &[
    (libc::SYS_fcntl, &[F_SETOWN, F_SETSIG, F_SETOWN_EX]),
    (libc::SYS_ioctl, &[FIOSETOWN, SIOCSPGRP]),
];

// The numbers of the kernel's `asm-generic`, on all machines that the filter can be made for; `libc` lacks some.
const F_SETOWN: u64 = 8;
const F_SETSIG: u64 = 10;
const F_SETOWN_EX: u64 = 15;
const FIOSETOWN: u64 = 0x8901;
const SIOCSPGRP: u64 = 0x8902;

/// Calls that open a file, and which argument has the flags.
const OPEN: &[(i64, u8)] = &[
    (libc::SYS_openat, 2),
    #[cfg(target_arch = "x86_64")]
    (libc::SYS_open, 1),
];

fn condition(
    argument: u8,
    operator: SeccompCmpOp,
    value: u64,
) -> Result<SeccompCondition, seccompiler::BackendError> {
    SeccompCondition::new(argument, SeccompCmpArgLen::Dword, operator, value)
}

fn program(
    mut rules: BTreeMap<i64, Vec<SeccompRule>>,
    error: i32,
) -> Result<BpfProgram, seccompiler::BackendError> {
    if cfg!(target_arch = "x86_64") {
        let twins: Vec<_> = rules.iter().map(|(n, r)| (n | X32, r.clone())).collect();
        rules.extend(twins);
    }
    let filter = SeccompFilter::new(
        rules,
        SeccompAction::Allow,
        SeccompAction::Errno(error as u32),
        std::env::consts::ARCH.try_into()?,
    );
    filter?.try_into()
}

const DENIED: &[i64] = &[
    // Network.
    libc::SYS_socket,
    libc::SYS_io_uring_setup,
    // Other processes.
    libc::SYS_execve,
    libc::SYS_execveat,
    libc::SYS_kill,
    libc::SYS_tkill,
    libc::SYS_rt_sigqueueinfo,
    libc::SYS_rt_tgsigqueueinfo,
    libc::SYS_pidfd_send_signal,
    libc::SYS_pidfd_getfd,
    libc::SYS_ptrace,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_setpriority,
    libc::SYS_ioprio_set,
    libc::SYS_sched_setaffinity,
    libc::SYS_sched_setattr,
    libc::SYS_sched_setparam,
    libc::SYS_sched_setscheduler,
    // Files that are there. openat2 hides its flags.
    libc::SYS_openat2,
    libc::SYS_truncate,
    libc::SYS_fchmod,
    libc::SYS_fchmodat,
    libc::SYS_fchmodat2,
    libc::SYS_fchown,
    libc::SYS_fchownat,
    libc::SYS_utimensat,
    libc::SYS_setxattr,
    libc::SYS_lsetxattr,
    libc::SYS_fsetxattr,
    libc::SYS_removexattr,
    libc::SYS_lremovexattr,
    libc::SYS_fremovexattr,
    // The system.
    libc::SYS_mount,
    libc::SYS_umount2,
    libc::SYS_unshare,
    libc::SYS_setns,
    libc::SYS_bpf,
    libc::SYS_perf_event_open,
    libc::SYS_userfaultfd,
    libc::SYS_add_key,
    libc::SYS_request_key,
    libc::SYS_keyctl,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_fork,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_vfork,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_chmod,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_chown,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_lchown,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_utime,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_utimes,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_futimesat,
];
