//! The memory of the machine.

use std::fs;
use std::path::{Path, PathBuf};

/// Bytes that the process can use without swap space, within the limits of its control groups. Memory that holds copies
/// of files counts as free, because the system gives it up when it is needed. `None` if this is unknown, as on systems
/// other than Linux.
pub fn available() -> Option<u64> {
    available_below(Path::new("/"))
}

/// [`available`], with the free swap space, within the limits of control groups on it.
pub fn available_with_swap() -> Option<u64> {
    available_with_swap_below(Path::new("/"))
}

fn available_below(root: &Path) -> Option<u64> {
    available_in(root, &groups(root))
}

fn available_in(root: &Path, groups: &[Group]) -> Option<u64> {
    let left = groups.iter().filter_map(Group::memory_left).min();
    Some(kilobytes(root, "MemAvailable:")?.min(left.unwrap_or(u64::MAX)))
}

fn available_with_swap_below(root: &Path) -> Option<u64> {
    let groups = groups(root);
    let swap = groups.iter().filter_map(Group::swap_left).min().unwrap_or(u64::MAX);
    let swap = swap.min(kilobytes(root, "SwapFree:").unwrap_or(0));
    let both = groups.iter().filter_map(Group::memory_and_swap_left).min().unwrap_or(u64::MAX);
    Some(available_in(root, &groups)?.saturating_add(swap).min(both))
}

/// The bytes in a line of `/proc/meminfo`.
fn kilobytes(root: &Path, name: &str) -> Option<u64> {
    let info = fs::read_to_string(root.join("proc/meminfo")).ok()?;
    let value = info.lines().find_map(|line| line.strip_prefix(name))?;
    Some(value.trim().trim_end_matches(" kB").parse::<u64>().ok()? * 1024)
}

/// The control groups of the process that may limit its memory, with all groups around them.
fn groups(root: &Path) -> Vec<Group> {
    let lines = fs::read_to_string(root.join("proc/self/cgroup")).unwrap_or_default();
    lines.lines().filter_map(|line| groups_of(root, line)).flatten().collect()
}

/// The group that a line of `/proc/self/cgroup` names, and all groups around it.
fn groups_of(root: &Path, line: &str) -> Option<Vec<Group>> {
    let mut parts = line.splitn(3, ':').skip(1);
    let (controllers, group) = (parts.next()?, parts.next()?);
    let is_second = controllers.is_empty();
    if !is_second && !controllers.split(',').any(|name| name == "memory") {
        return None;
    }
    let all = root.join("sys/fs/cgroup");
    let top = if is_second { all } else { all.join("memory") };
    // In a container the name may be known only outside it. The folder at the top is then that of the container's own
    // group.
    let own = top.join(group.trim_start_matches('/'));
    let folders = own.ancestors().take_while(|folder| folder.starts_with(&top));
    Some(folders.map(|folder| Group { folder: folder.to_owned(), is_second }).collect())
}

/// A control group of Linux.
struct Group {
    folder: PathBuf,
    /// Whether its files are those of version 2 of the interface, not of version 1.
    is_second: bool,
}

impl Group {
    /// Bytes of memory that it has left. What belongs to files is not counted as used.
    fn memory_left(&self) -> Option<u64> {
        match self.is_second {
            true => Some(self.number("memory.max")?.saturating_sub(self.count("anon ")?)),
            false => Some(self.number("memory.limit_in_bytes")?.saturating_sub(self.count("total_rss ")?)),
        }
    }

    /// Bytes of swap space that it has left. Only version 2 limits them alone.
    fn swap_left(&self) -> Option<u64> {
        Some(self.number("memory.swap.max")?.saturating_sub(self.number("memory.swap.current")?))
    }

    /// Bytes of memory and swap space that it has left together. Only version 1 limits their sum.
    fn memory_and_swap_left(&self) -> Option<u64> {
        let used = self.count("total_rss ")?.saturating_add(self.count("total_swap ")?);
        Some(self.number("memory.memsw.limit_in_bytes")?.saturating_sub(used))
    }

    /// The number in a file. `None` for `max`, which is no limit.
    fn number(&self, file: &str) -> Option<u64> {
        fs::read_to_string(self.folder.join(file)).ok()?.trim().parse().ok()
    }

    /// The number in the line of `memory.stat` that begins like this.
    fn count(&self, name: &str) -> Option<u64> {
        let stat = fs::read_to_string(self.folder.join("memory.stat")).ok()?;
        stat.lines().find_map(|line| line.strip_prefix(name))?.parse().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A system with these files.
    fn system(files: &[(&str, &str)]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for (name, text) in files {
            let path = root.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        root
    }

    const INFO: (&str, &str) = ("proc/meminfo", "MemTotal: 9000 kB\nMemAvailable:    4000 kB\nSwapFree: 7 kB\n");

    /// Without control groups, `/proc/meminfo` decides. Without that file, the memory is unknown.
    #[test]
    fn the_machine_says_what_is_available() {
        assert_eq!(available_below(system(&[INFO]).path()), Some(4000 * 1024));
        assert_eq!(kilobytes(system(&[INFO]).path(), "SwapFree:"), Some(7 * 1024));
        assert_eq!(available_below(system(&[]).path()), None);
    }

    /// The smallest limit of a group and of those around it counts, without what its processes use; copies of files do
    /// not count.
    #[test]
    fn groups_limit_what_is_available() {
        let second = [
            INFO,
            ("proc/self/cgroup", "0::/outer/inner\n"),
            ("sys/fs/cgroup/outer/memory.max", "3000000\n"),
            ("sys/fs/cgroup/outer/memory.stat", "anon 1000000\nfile 500000\n"),
            ("sys/fs/cgroup/outer/inner/memory.max", "max\n"),
            ("sys/fs/cgroup/outer/inner/memory.stat", "anon 5\nfile 5\n"),
        ];
        assert_eq!(available_below(system(&second).path()), Some(2_000_000));
        // Of the machine's 7 KiB of swap space, the outer group may have 5000 bytes and has 2000.
        assert_eq!(available_with_swap_below(system(&second).path()), Some(2_000_000 + 7 * 1024));
        let swap = |limit| {
            let files = [("outer/memory.swap.max", limit), ("outer/memory.swap.current", "2000\n")];
            let files = files.map(|(name, text)| (format!("sys/fs/cgroup/{name}"), text));
            let files = files.iter().map(|(name, text)| (name.as_str(), *text));
            available_with_swap_below(system(&second.into_iter().chain(files).collect::<Vec<_>>()).path())
        };
        assert_eq!(swap("5000\n"), Some(2_000_000 + 3000));
        assert_eq!(swap("0\n"), Some(2_000_000));
        assert_eq!(swap("max\n"), Some(2_000_000 + 7 * 1024));
        // Seen from inside of the container, its own group is at the top.
        let first = [
            INFO,
            ("proc/self/cgroup", "5:cpu:/\n4:memory:/docker/1234\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "2500000\n"),
            ("sys/fs/cgroup/memory/memory.stat", "cache 7\nrss 8\ntotal_rss 500000\n"),
        ];
        assert_eq!(available_below(system(&first).path()), Some(2_000_000));
        // Swap space that only the machine has, and memory and swap space under one limit.
        assert_eq!(available_with_swap_below(system(&first).path()), Some(2_000_000 + 7 * 1024));
        let both = ("sys/fs/cgroup/memory/memory.memsw.limit_in_bytes", "2504000\n");
        let stat = (first[3].0, "total_rss 500000\ntotal_swap 1000\n");
        let first_swap = [first[0], first[1], first[2], stat, both];
        assert_eq!(available_with_swap_below(system(&first_swap).path()), Some(2_003_000));
        // The limit of a group that has none.
        let unlimited = [first[0], first[1], (first[2].0, "9223372036854771712\n"), first[3]];
        assert_eq!(available_below(system(&unlimited).path()), Some(4000 * 1024));
    }
}
