# wcsim without a GPU: `make demo`, or a node of a Ray cluster (docs/cluster.md). Run it with --shm-size=1g.
FROM python:3.11-slim-bookworm

RUN apt-get update \
 && apt-get install --yes --no-install-recommends make libgl1 libxext6 libxrender1 libatomic1 \
 && rm -rf /var/lib/apt/lists/*
# Its owner alone may read the token of a cluster, so a node's user has the number of whose token it is: docs/cluster.md
ARG USER_ID=1000
RUN useradd --create-home --uid "$USER_ID" wcsim && install --directory --owner=wcsim --group=wcsim /home/wcsim/wcsim
USER wcsim
WORKDIR /home/wcsim/wcsim
COPY --chown=wcsim:wcsim . .
# Of a mirror of one's own: --build-arg TORCH_INDEX=ADDRESS; with nothing after the = pip takes what its configuration says.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
RUN make setup TORCH_INDEX="$TORCH_INDEX"
ENV OMP_NUM_THREADS=1
CMD ["make", "demo"]
