//! The memory of the machine.

use std::fs;
use std::path::Path;

/// Where Linux limits the memory of control groups, first in version 2 of their interface, then in version 1: the
/// folder in the folder of all control groups, the file with the limit, and the beginning of the line of `memory.stat`
/// that counts the memory in use that belongs to no file.
const GROUPS: [(&str, &str, &str); 2] =
    [("", "memory.max", "anon "), ("memory", "memory.limit_in_bytes", "total_rss ")];

/// Bytes that the process can use without swap space, within the limits of its control groups. Memory that holds copies
/// of files counts as free, because the system gives it up when it is needed. `None` if this is unknown, as on systems
/// other than Linux.
pub fn available() -> Option<u64> {
    available_below(Path::new("/"))
}

/// [`available`], with the free swap space.
pub fn available_with_swap() -> Option<u64> {
    let swap = kilobytes(Path::new("/"), "SwapFree:").unwrap_or(0);
    Some(available()?.saturating_add(swap))
}

fn available_below(root: &Path) -> Option<u64> {
    let groups = fs::read_to_string(root.join("proc/self/cgroup")).unwrap_or_default();
    let of_groups = groups.lines().filter_map(|line| available_in_groups(root, line)).min();
    Some(kilobytes(root, "MemAvailable:")?.min(of_groups.unwrap_or(u64::MAX)))
}

/// The bytes in a line of `/proc/meminfo`.
fn kilobytes(root: &Path, name: &str) -> Option<u64> {
    let info = fs::read_to_string(root.join("proc/meminfo")).ok()?;
    let value = info.lines().find_map(|line| line.strip_prefix(name))?;
    Some(value.trim().trim_end_matches(" kB").parse::<u64>().ok()? * 1024)
}

/// The bytes that are left to the control group that a line of `/proc/self/cgroup` names, and to all groups around it.
fn available_in_groups(root: &Path, line: &str) -> Option<u64> {
    let mut parts = line.splitn(3, ':').skip(1);
    let (controllers, group) = (parts.next()?, parts.next()?);
    let version = if controllers.is_empty() { 0 } else { 1 };
    if version == 1 && !controllers.split(',').any(|name| name == "memory") {
        return None;
    }
    let (folder, limit, used) = GROUPS[version];
    let top = root.join("sys/fs/cgroup").join(folder);
    let left = |folder: &Path| -> Option<u64> {
        let limit: u64 = fs::read_to_string(folder.join(limit)).ok()?.trim().parse().ok()?;
        let stat = fs::read_to_string(folder.join("memory.stat")).ok()?;
        let used: u64 = stat.lines().find_map(|line| line.strip_prefix(used))?.parse().ok()?;
        Some(limit.saturating_sub(used))
    };
    // In a container the name may be known only outside it. The folder at the top is then that of the container's own
    // group.
    let own = top.join(group.trim_start_matches('/'));
    own.ancestors().take_while(|folder| folder.starts_with(&top)).filter_map(left).min()
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
        // Seen from inside of the container, its own group is at the top.
        let first = [
            INFO,
            ("proc/self/cgroup", "5:cpu:/\n4:memory:/docker/1234\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "2500000\n"),
            ("sys/fs/cgroup/memory/memory.stat", "cache 7\nrss 8\ntotal_rss 500000\n"),
        ];
        assert_eq!(available_below(system(&first).path()), Some(2_000_000));
        // The limit of a group that has none.
        let unlimited = [first[0], first[1], (first[2].0, "9223372036854771712\n"), first[3]];
        assert_eq!(available_below(system(&unlimited).path()), Some(4000 * 1024));
    }
}
