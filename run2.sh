. /tmp/sets/env.sh
echo 8 > /proc/self/autogroup
cd /tmp/sets/big
python make.py && ls drive | wc -l
mkdir -p short; for n in $(seq -w 0 299); do ln -f drive/000$n.png short/; done
rm -rf S1 S2 A
/usr/bin/time -v python -m kt3dmoseg.cli choose short -o S1 --movers mseg > S1.out 2> S1.time
timeout -s KILL 40 python -m kt3dmoseg.cli choose short -o S2 --movers mseg > S2k.out 2>&1
echo "short killed with $(ls S2/measured | wc -l) of $(ls S1/measured | wc -l) parts" > A.note
python -m kt3dmoseg.cli choose short -o S2 --movers mseg > S2.out 2>&1
for f in candidates.csv index.html candidates.toml; do cmp S1/$f S2/$f && echo "same $f" >> A.note; done
timeout -s KILL 240 python -m kt3dmoseg.cli choose drive -o A --movers mseg > A1.out 2>&1
echo "long killed with $(ls A/measured | wc -l) parts" >> A.note
/usr/bin/time -v python -m kt3dmoseg.cli choose drive -o A --movers mseg > A2.out 2> A2.time
echo done >> A.note
