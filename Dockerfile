# Anther with all that its demo and its tests need, run by a user without rights on a root that is only read:
#
#   docker build -t anther .
#   docker run --rm --read-only --tmpfs /tmp:exec --tmpfs /anther/runs:uid=1000 anther          # the demo
#   docker run --rm --read-only --tmpfs /tmp:exec --tmpfs /anther/runs:uid=1000 anther make test
#   docker run --rm --read-only --tmpfs /tmp:exec -v "$PWD:/data" anther anther skeletonize /data/plant.ply --out /data/tree
# bookworm-slim of 3 August 2026, all platforms, as docker-library/repo-info lists it; how to renew it: CONTRIBUTING.md.
FROM debian:bookworm-slim@sha256:abd67ffcfa541b485a3dff59865ab629aa048a6c613e639d36e7456b0b229241

# Anther's own. Of the Python packages: docs/licences.md (none under the GPL); of Debian's: /usr/share/doc/*/copyright.
LABEL org.opencontainers.image.licenses="Apache-2.0"

# Tests that start a browser, a PostgreSQL server or a ROS 1 master are skipped without these.
ARG FOR_TESTS="chromium fonts-dejavu-core libatomic1 postgresql python3-roslaunch python3-rospy python3-std-msgs"
RUN apt-get update \
    && apt-get install -y --no-install-recommends ca-certificates libgomp1 make python3 python3-venv $FOR_TESTS \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 1000 --create-home anther

WORKDIR /anther
COPY . .
RUN make sync && mkdir runs

# Whatever is written goes to /tmp: compiled code, caches, temporary files.
ENV PATH=/anther/.venv/bin:$PATH HOME=/tmp PYTHONDONTWRITEBYTECODE=1 PYTEST_ADDOPTS="-p no:cacheprovider"
USER anther
CMD ["make", "demo"]
