//! Receivers that share no probe are factorised apart: then the error of one room's factors cannot shine into the
//! next, and a dark room stays exactly dark. (With patches: no patch, and no texel close by.)

/// Groups rows that are linked by columns' probes. `links[r]` lists the probes that row r uses.
///
/// Gives groups of ascending row indices, by first row. Rows without any probe form one group.
pub fn components(links: &[Vec<u32>], probes: usize) -> Vec<Vec<usize>> {
    // Union-find over probes; one more node stands for "no probe".
    let mut parent: Vec<usize> = (0..=probes).collect();
    for link in links {
        for pair in link.windows(2) {
            let (a, b) = (root(&mut parent, pair[0] as usize), root(&mut parent, pair[1] as usize));
            parent[a.max(b)] = a.min(b);
        }
    }
    let mut group_of_root = vec![usize::MAX; probes + 1];
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (row, link) in links.iter().enumerate() {
        let root = root(&mut parent, link.first().map_or(probes, |probe| *probe as usize));
        if group_of_root[root] == usize::MAX {
            group_of_root[root] = groups.len();
            groups.push(Vec::new());
        }
        groups[group_of_root[root]].push(row);
    }
    groups
}

fn root(parent: &mut [usize], mut node: usize) -> usize {
    while parent[node] != node {
        parent[node] = parent[parent[node]];
        node = parent[node];
    }
    node
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_linked_through_shared_probes_only() {
        let links = vec![vec![0, 1], vec![3], vec![1, 2], vec![], vec![3], vec![]];
        assert_eq!(components(&links, 4), vec![vec![0, 2], vec![1, 4], vec![3, 5]]);
    }
}
